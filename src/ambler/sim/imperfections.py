"""What is a little off in every real installation, drawn per run: mounting and lens of the camera, markers, the contact's switch, floor, wheels.

It changes the simulated truth alone. The robot's own description, its calibration and its docks say what was drawn on paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3, Vector3
from ambler.sim.meshes import HeightField
from ambler.sim.sensors import named_generator
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Person, Shape, SimDock, SimMarker, WorldSpec

F64 = NDArray[np.float64]
NOWHERE: Vector3 = (0.0, 0.0, 0.0)
GROUND = 0.65  # metres between the samples of a floor, along the dock's axes
AROUND = 2 * GROUND  # metres about a docked robot's middle within which its floor is one plane
LEVELLING = 0.5  # metres over which that plane goes over into a level floor
BESIDE = 0.5  # metres that the floor reaches beyond the walls
START = 1.5  # metres about a start in which nobody walks
PASSERBY = "passer_by"
NEAREST, WALK = (
    1.1,
    4.0,
)  # metres beside a dock's line between which somebody walks: who comes from the side sees it hidden
BODY = 0.45  # metres that must be free about them


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Half widths within which everything is drawn, evenly: place (m) and turn (rad) of the camera's mounting, share of each of its focal lengths
    and of its centre, place, turn and share of the side of each marker, the depth (m) at which the switch closes, the tilt (rad) of the floor
    under a docked robot. `slip` and `friction`: from, to (share of the way, coefficient); `strafe` up to (share). `passers_by`: share of
    the runs in which somebody walks to and fro beside the dock, `passing` metres ahead of the docked pose, at `pace` m/s."""

    camera_place: float = 0.002
    camera_turn: float = math.radians(0.3)
    lens: float = 0.003
    marker_place: float = 0.001
    marker_turn: float = math.radians(0.3)
    marker_size: float = 0.003
    contact: float = 0.001
    tilt: float = math.radians(0.3)
    slip: tuple[float, float] = (0.005, 0.03)
    friction: tuple[float, float] = (0.5, 0.9)
    strafe: float = 0.05
    passers_by: float = 0.5
    passing: tuple[float, float] = (-0.4, 0.2)
    pace: tuple[float, float] = (0.7, 1.3)


@dataclass(frozen=True, slots=True)
class MarkerFlaw:
    """How a marker hangs beside its drawing, in its own frame: metres, radians (roll, pitch, yaw), and the share by which it is larger."""

    place: Vector3 = NOWHERE
    turn: Vector3 = NOWHERE
    size: float = 0.0


@dataclass(frozen=True, slots=True)
class Imperfections:
    """What is off at `dock` and on a robot that docks there. `camera_*` in the base frame; `lens`: shares of (fx, fy, cx, cy); `contact`: how much
    deeper (m) the switch closes; `tilt`: rise of the floor along the dock's x and y (rad); `passer_by`: metres ahead of the docked pose,
    m/s, and the side (1: left), None: nobody."""

    dock: str
    camera_place: Vector3
    camera_turn: Vector3
    lens: tuple[float, float, float, float]
    markers: tuple[MarkerFlaw, ...]
    contact: float
    tilt: tuple[float, float]
    slip: float
    friction: float
    strafe_loss: float
    passer_by: tuple[float, float, float] | None

    def beginning_at(self, dock_from_base: SE2) -> Imperfections:
        """Return the same for a robot that starts there: nobody walks where it stands."""
        passing = self.passer_by
        beside = 0.0 if passing is None else passing[2] * dock_from_base.y
        is_far = not NEAREST - START < beside < WALK + START
        if passing is None or abs(dock_from_base.x - passing[0]) > START or is_far:
            return self
        return replace(self, passer_by=None)

    def of_robot(self, robot: SimRobot) -> SimRobot:
        """Return the robot as it was built: its cameras moved and ground otherwise than drawn, its wheels slipping as they do here."""
        odometry = replace(robot.odometry, slip_sigma=self.slip)
        strafe = self.strafe_loss if robot.strafe_loss > 0.0 else 0.0
        cameras = {frame: replace(spec, model=self._lens(spec.model)) for frame, spec in robot.cameras.items()}
        return replace(robot, model=self._mounted(robot.model), odometry=odometry, strafe_loss=strafe, cameras=cameras)

    def of_world(self, world: WorldSpec) -> WorldSpec:
        """Return the world as it was built; raises KeyError when it does not have the dock."""
        dock = next((d for d in world.docks if d.name == self.dock), None)
        if dock is None:
            raise KeyError(f"world {world.name} has no dock {self.dock!r}")
        docks = tuple(self._built(d) if d is dock else d for d in world.docks)
        people = world.people + (() if self.passer_by is None else self._somebody(world, dock))
        terrain = self._floor(world, dock) if world.is_flat else world.terrain
        return replace(world, docks=docks, people=people, terrain=terrain, friction=self.friction)

    def told(self) -> dict[str, Any]:
        """Return all of it as flat values for a table, in mm, degrees and shares."""
        values: dict[str, Any] = {}
        for axis, place, turn in zip("xyz", self.camera_place, self.camera_turn, strict=True):
            values |= {f"camera_{axis}_mm": 1e3 * place, f"camera_turn_{axis}_deg": math.degrees(turn)}
        values |= dict(zip(("lens_fx", "lens_fy", "lens_cx", "lens_cy"), self.lens, strict=True))
        for k, flaw in enumerate(self.markers):
            for axis, place, turn in zip("xyz", flaw.place, flaw.turn, strict=True):
                values |= {f"marker{k}_{axis}_mm": 1e3 * place, f"marker{k}_turn_{axis}_deg": math.degrees(turn)}
            values[f"marker{k}_size"] = flaw.size
        values |= {"contact_mm": 1e3 * self.contact, "slip": self.slip, "friction": self.friction}
        values |= {f"floor_{axis}_deg": math.degrees(rise) for axis, rise in zip("xy", self.tilt, strict=True)}
        return values | {"strafe_loss": self.strafe_loss, "has_passer_by": self.passer_by is not None}

    def _mounted(self, model: RobotModel) -> RobotModel:
        x, y, z = self.camera_place
        moved = []
        for mount in model.sensors:
            pose = mount.base_from_sensor
            if mount.kind is SensorKind.CAMERA:
                at = pose.translation
                turn = SE3.from_rpy(NOWHERE, *self.camera_turn) @ SE3(rotation=pose.rotation)
                pose = SE3((at[0] + x, at[1] + y, at[2] + z), turn.rotation)
            moved.append(replace(mount, base_from_sensor=pose))
        return replace(model, sensors=tuple(moved))

    def _lens(self, model: CameraModel) -> CameraModel:
        fx, fy, cx, cy = (1.0 + share for share in self.lens)
        return replace(model, fx=model.fx * fx, fy=model.fy * fy, cx=model.cx * cx, cy=model.cy * cy)

    def _built(self, dock: SimDock) -> SimDock:
        markers = tuple(_hung(m, flaw) for m, flaw in zip(dock.markers, self.markers, strict=True))
        return replace(dock, markers=markers, contact=self.contact)

    def _floor(self, world: WorldSpec, dock: SimDock) -> HeightField:
        """A plane under the docked robot, level farther away."""
        x0, y0, x1, y1 = world.bounds()
        corners = dock.world_from_dock.inverse().transform(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        low, high = np.floor((corners.min(axis=0) - BESIDE) / GROUND), np.ceil((corners.max(axis=0) + BESIDE) / GROUND)
        x, y = (_levelled(GROUND * np.arange(a, b + 1.0)) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        heights = math.tan(self.tilt[0]) * x[None, :] + math.tan(self.tilt[1]) * y[:, None]
        origin = dock.world_from_dock @ SE2(GROUND * float(low[0]), GROUND * float(low[1]), 0.0)
        return HeightField("ground", heights, GROUND, origin, world.floor_albedo)

    def _somebody(self, world: WorldSpec, dock: SimDock) -> tuple[Person, ...]:
        """Somebody who walks to and fro beside the dock's line, as far away from it as nothing stands there."""
        assert self.passer_by is not None
        ahead, pace, side = self.passer_by
        steps = np.column_stack([np.full(31, ahead), side * np.linspace(NEAREST, WALK, 31)])
        way = dock.world_from_dock.transform(steps)
        is_free = _is_free(world, way)
        last = len(way) if is_free.all() else int(np.argmin(is_free))
        if last < 2:
            return ()
        ends = way[[0, last - 1]].tolist()
        return (Person(PASSERBY, tuple((x, y) for x, y in ends), pace),)


def draw_imperfections(seed: int, dock: SimDock, tolerances: Tolerances | None = None) -> Imperfections:
    """Draw what is off at a dock and on the robot that goes there; the same seed draws the same."""
    t = tolerances if tolerances is not None else Tolerances()
    rng = named_generator(seed, "imperfections")

    def three(half: float) -> Vector3:
        x, y, z = rng.uniform(-half, half, 3).tolist()
        return (x, y, z)

    def one(half: float) -> float:
        return float(rng.uniform(-half, half))

    place, turn = three(t.camera_place), three(t.camera_turn)
    fx, fy, cx, cy = rng.uniform(-t.lens, t.lens, 4).tolist()
    markers = tuple(MarkerFlaw(three(t.marker_place), three(t.marker_turn), one(t.marker_size)) for _ in dock.markers)
    contact, tilt = one(t.contact), (one(t.tilt), one(t.tilt))
    slip, friction = float(rng.uniform(*t.slip)), float(rng.uniform(*t.friction))
    strafe, is_passed = float(rng.uniform(0.0, t.strafe)), float(rng.uniform()) < t.passers_by
    passer_by = (float(rng.uniform(*t.passing)), float(rng.uniform(*t.pace)), float(rng.choice((-1.0, 1.0))))
    return Imperfections(
        dock.name,
        place,
        turn,
        (fx, fy, cx, cy),
        markers,
        contact,
        tilt,
        slip,
        friction,
        strafe,
        passer_by if is_passed else None,
    )


def _hung(marker: SimMarker, flaw: MarkerFlaw) -> SimMarker:
    return replace(marker, size=marker.size * (1.0 + flaw.size), place=flaw.place, turn=flaw.turn)


def _levelled(points: F64) -> F64:
    """Coordinates whose growth ends beyond AROUND: heights that rise with them are level there."""
    over = np.maximum(np.abs(points) - AROUND, 0.0)
    return np.asarray(np.sign(points) * (np.minimum(np.abs(points), AROUND) + LEVELLING * -np.expm1(-over / LEVELLING)))


def _is_free(world: WorldSpec, points: F64) -> NDArray[np.bool_]:
    """Whether a body stands free of every solid at points (N, 2)."""
    free = np.ones(len(points), np.bool_)
    low = [solid for solid in world.solids if solid.z_min < 1.7]
    for solid in low:
        local = solid.world_from_solid.inverse().transform(points)
        half = 0.5 * np.array([solid.size_x, solid.size_y])
        if solid.shape is Shape.CYLINDER:
            free &= np.hypot(*local.T) > half[0] + BODY
        else:
            free &= np.hypot(*np.maximum(np.abs(local) - half, 0.0).T) > BODY
    return free
