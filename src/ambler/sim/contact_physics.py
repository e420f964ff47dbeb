"""Contact physics with MuJoCo: two hinge wheels and a caster, or four spheres with a surface velocity (mecanum wheels, legs).

Slip, traction limits and pushing come out of the contact solver. A sphere's surface velocity is -(v + w x r) of the body
velocity that the wheels or legs work for (simulation.md §1b).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.base import Carriage, Touch
from ambler.sim.drive import after_strafe_loss, drive_of
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_contact import STEEP, ground_names, rest_pose, surfaces_xml

FOOT_RADIUS = 0.05
WHEEL_WIDTH = 0.04
# Reflected inertia of motor and gear (kg m^2) and speed gain (N m s): the gain times the step stays below the inertia, so
# that an explicit integrator is stable; an implicit one would move wheels other than the contact solver assumed.
WHEEL_ARMATURE = 0.06
WHEEL_GAIN = 10.0
# Where the ground is not flat, wheels have an integral part too (1/s), or a robot that stands on a slope would creep down. It takes up
# to the load of a slope of 30 degrees.
WHEEL_INTEGRAL = 5.0


class ContactPhysics:
    """One robot in one world, in the map frame, starting at the origin."""

    def __init__(self, world: WorldSpec, robot: SimRobot, dt: float, movers: Sequence[Solid] = ()) -> None:
        self._robot = robot
        self._model: Any = mujoco.MjModel.from_xml_string(build_mjcf(world, robot, dt, movers))
        self._data: Any = mujoco.MjData(self._model)
        self._step: Any = mujoco.mj_step
        self._dt = dt
        self._qpos, self._qvel, self._ctrl = self._data.qpos, self._data.qvel, self._data.ctrl
        self._has_wheels = robot.has_two_wheels
        self._drive = drive_of(robot)
        self._feet = [] if self._has_wheels else self._find_feet()
        self._surface = self._model.geom_surfacevel
        self._turned = [0.0] * self._drive.parts
        base = self._model.body("base").id
        self._is_own = self._model.body_rootid[self._model.geom_bodyid] == base
        self._floor = self._model.geom("floor").id
        self._start = rest_pose(world, SE2(), robot.model.footprint)
        self._is_flat = world.is_flat
        self._is_ground, self._is_gear = self._find_ground(world)
        self._carried = np.zeros(2)
        self._carried_max = 0.25 * robot.mass * 9.81 * robot.wheel_radius / WHEEL_GAIN
        self._hull_force = self._data.sensordata
        self._speed_before = (0.0, 0.0, 0.0)
        self._carriage = Carriage((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        self._settle()

    def step(self, target: BodyVelocity) -> None:
        """Advance by one physics step."""
        if self._has_wheels:
            self._ctrl[0], self._ctrl[1] = self._drive.rates(target)
            if not self._is_flat:
                self._carry_load()
        else:
            self._set_surface(target)
        v = self._qvel
        self._speed_before = (float(v[0]), float(v[1]), float(v[5]))
        self._step(self._model, self._data)
        q = self._qpos[:7].tolist()
        self._carriage = Carriage((q[0], q[1], q[2]), (q[3], q[4], q[5], q[6]))

    @property
    def carriage(self) -> Carriage:
        return self._carriage

    @property
    def travel(self) -> tuple[float, ...]:
        if self._has_wheels:
            return (float(self._qpos[7]), float(self._qpos[8]))
        return tuple(self._turned)

    def move(self, movers: Sequence[Solid]) -> None:
        """Put everything that moves by itself to where it is now."""
        for k, solid in enumerate(movers):
            self._data.mocap_pos[k, 0] = solid.map_from_solid.x
            self._data.mocap_pos[k, 1] = solid.map_from_solid.y

    def touches(self) -> tuple[Touch, ...]:
        """Contacts of the robot's own parts with solids, at the end of the last step."""
        if self._hull_force[0] == 0.0:
            return ()
        contact = self._data.contact
        geoms = contact.geom
        is_touch = (geoms != self._floor).all(axis=1) & (contact.dist < 1e-3)
        if not self._is_flat:
            is_driving = self._is_ground[geoms].any(axis=1) & self._is_gear[geoms].any(axis=1)
            is_touch &= ~(is_driving & (np.abs(contact.frame[:, 2]) >= STEEP))
        others = np.nonzero(is_touch)[0]
        return tuple(self._touch(int(k)) for k in others)

    def _touch(self, k: int) -> Touch:
        contact = self._data.contact[k]
        a, b = int(contact.geom[0]), int(contact.geom[1])
        part, solid = (a, b) if self._is_own[a] else (b, a)
        x, y, z = (float(p) for p in contact.pos)
        vx, vy, wz = self._speed_before
        cx, cy, _ = self._carriage.position
        speed = math.hypot(vx - wz * (y - cy), vy + wz * (x - cx))
        force = np.zeros(6)
        mujoco.mj_contactForce(self._model, self._data, k, force)
        names = self._model.geom
        return Touch(names(part).name, names(solid).name.rsplit("#", 1)[0], (x, y, z), speed, float(abs(force[0])))

    def _put_back(self) -> None:
        """Move the base along the ground to where it started, and turn it to its first heading; what is level becomes exactly so."""
        if self._is_flat:
            self._qpos[0], self._qpos[1] = 0.0, 0.0
            self._qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
            return
        rested = SE3(tuple(self._qpos[:3]), tuple(self._qpos[3:7]))
        up = self._start.matrix()[:3, 2]
        lifted = up * float(up @ np.subtract(rested.translation, self._start.translation))
        back = self._start.to_se2().yaw - rested.to_se2().yaw
        turned = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, back) @ rested
        self._qpos[:3], self._qpos[3:7] = np.add(self._start.translation, lifted), turned.rotation

    def _find_ground(self, world: WorldSpec) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Tell of every geom whether it is terrain or mesh, and whether it is a wheel, caster or foot."""
        grounds = ground_names(world)
        names = [str(self._model.geom(k).name) for k in range(self._model.ngeom)]
        is_ground = np.array([n.rpartition("#")[0] in grounds for n in names]) & ~self._is_own
        return is_ground, self._is_own & np.array([n != "body" for n in names])

    def _carry_load(self) -> None:
        """Add to the wheels' wanted rates what the load, by which they fall short of them, asks for."""
        missing = self._ctrl[:2] - self._qvel[6:8]
        self._carried = np.clip(
            self._carried + WHEEL_INTEGRAL * self._dt * missing, -self._carried_max, self._carried_max
        )
        self._ctrl[:2] += self._carried

    def _find_feet(self) -> list[tuple[int, float, float]]:
        ids = [self._model.geom(f"foot_{i}").id for i in range(4)]
        return [(i, float(self._model.geom_pos[i, 0]), float(self._model.geom_pos[i, 1])) for i in ids]

    def _set_surface(self, target: BodyVelocity) -> None:
        moved = after_strafe_loss(self._robot, target)
        for geom, x, y in self._feet:
            self._surface[geom, 0] = -(moved.vx - moved.wz * y)
            self._surface[geom, 1] = -(moved.vy + moved.wz * x)
        for k, rate in enumerate(self._drive.rates(target)):
            self._turned[k] += rate * self._dt

    def _settle(self) -> None:
        """Let the robot come to rest on the ground, then put it back to the origin."""
        self._qpos[:3], self._qpos[3:7] = self._start.translation, self._start.rotation
        if not self._has_wheels:
            self._set_surface(BodyVelocity())
        for _ in range(200):
            if self._has_wheels and not self._is_flat:
                self._ctrl[:] = 0.0
                self._carry_load()
            self._step(self._model, self._data)
        self._put_back()
        self._qpos[7:] = 0.0
        self._qvel[:] = 0.0
        self._data.time = 0.0
        mujoco.mj_forward(self._model, self._data)
        self._turned = [0.0] * self._drive.parts
        q = self._qpos[:7].tolist()
        self._carriage = Carriage((q[0], q[1], q[2]), (q[3], q[4], q[5], q[6]))


def build_mjcf(world: WorldSpec, robot: SimRobot, dt: float, movers: Sequence[Solid] = ()) -> str:
    """Return the MuJoCo model of a world with one robot at the origin; `movers` are bodies that are put where they are."""
    solids = "\n".join(_solid_xml(k, s, _place(s)) for k, s in enumerate(world.solids))
    solids += "\n".join(
        f'<body mocap="true" {_place(s)}>{_solid_xml(len(world.solids) + k, s, "")}</body>'
        for k, s in enumerate(movers)
    )
    drive, actuators = _wheels_xml(robot) if robot.has_two_wheels else (_feet_xml(robot), "")
    surface_assets, surfaces = surfaces_xml(world)
    levels = (robot.body_bottom, robot.model.body_height)
    hull = " ".join(f"{x:.6f} {y:.6f} {z:.6f}" for z in levels for x, y in robot.model.footprint)
    center_x = -0.05 if robot.has_two_wheels else 0.0
    return f"""<mujoco model="{robot.model.name}">
<compiler angle="radian" autolimits="true"/>
<option timestep="{dt!r}" integrator="Euler" cone="elliptic" impratio="10"/>
<default><geom friction="0.3 0.005 0.0001"/></default>
<asset><mesh name="hull" vertex="{hull}"/>
{surface_assets}</asset>
<worldbody>
<geom name="floor" type="plane" pos="0 0 {world.floor!r}" size="0 0 1" priority="1" friction="{world.friction!r} 0.005 0.0001"/>
{solids}
{surfaces}
<body name="base"><freejoint/>
<inertial pos="{center_x!r} 0 {0.4 * sum(levels)!r}" mass="{robot.mass!r}" diaginertia="{_inertia(robot)}"/>
<geom name="body" type="mesh" mesh="hull"/>
<site name="hull" type="box" pos="0 0 {0.5 * sum(levels)!r}" size="{_hull_size(robot)}"/>
{drive}
</body>
</worldbody>
{actuators}
<sensor><touch site="hull"/></sensor>
</mujoco>"""


def _inertia(robot: SimRobot) -> str:
    length, width = np.ptp(robot.model.footprint, axis=0).tolist()
    height, k = robot.model.body_height - robot.body_bottom, robot.mass / 12.0
    return f"{k * (width**2 + height**2)} {k * (length**2 + height**2)} {k * (length**2 + width**2)}"


def _hull_size(robot: SimRobot) -> str:
    """Half sizes of a box 2 cm around the body; the touch sensor in it tells cheaply whether contacts need a look."""
    length, width = np.ptp(robot.model.footprint, axis=0).tolist()
    height = robot.model.body_height - robot.body_bottom
    return f"{0.5 * length + 0.02} {0.5 * width + 0.02} {0.5 * height + 0.02}"


def _place(s: Solid) -> str:
    pose = s.map_from_solid
    turn = f"{math.cos(pose.yaw / 2)!r} 0 0 {math.sin(pose.yaw / 2)!r}"
    return f'pos="{pose.x!r} {pose.y!r} {0.5 * (s.z_min + s.z_max)!r}" quat="{turn}"'


def _solid_xml(k: int, s: Solid, place: str) -> str:
    half = 0.5 * (s.z_max - s.z_min)
    if s.shape is Shape.BOX:
        kind, size = "box", f"{0.5 * s.size_x!r} {0.5 * s.size_y!r} {half!r}"
    else:
        kind, size = "cylinder", f"{0.5 * s.size_x!r} {half!r}"
    return f'<geom name={quoteattr(f"{s.name}#{k}")} type="{kind}" size="{size}" {place}/>'


def _wheels_xml(robot: SimRobot) -> tuple[str, str]:
    """Two driven hinge wheels (ellipsoids: one contact each) on the base's y axis and a frictionless caster behind."""
    r, half = robot.wheel_radius, 0.5 * robot.track
    back = -0.7 * float(robot.model.footprint[:, 0].max())
    bodies, motors = [], []
    for side, y in (("left", half), ("right", -half)):
        bodies.append(
            f'<body name="wheel_{side}" pos="0 {y!r} {r!r}"><joint name="{side}" type="hinge" axis="0 1 0" armature="{WHEEL_ARMATURE!r}"/>'
            f'<geom name="wheel_{side}" type="ellipsoid" size="{r!r} {0.5 * WHEEL_WIDTH!r} {r!r}" mass="0.8"/></body>'
        )
        torque = robot.mass * 9.81 * r
        motors.append(f'<velocity joint="{side}" kv="{WHEEL_GAIN!r}" forcerange="{-torque!r} {torque!r}"/>')
    caster = f'<geom name="caster" type="sphere" size="0.03" pos="{back!r} 0 0.03" priority="2" condim="1" mass="0"/>'
    return "\n".join([*bodies, caster]), f"<actuator>{''.join(motors)}</actuator>"


def _feet_xml(robot: SimRobot) -> str:
    """Four spheres, wheels or feet near the corners, whose surface moves; MuJoCo wants one non-zero surface velocity when it
    compiles."""
    if robot.has_mecanum_wheels:
        radius, x, y = robot.wheel_radius, 0.5 * robot.wheel_base, 0.5 * robot.track
    else:
        radius, (x, y) = FOOT_RADIUS, (robot.model.footprint.max(axis=0) - [0.15, 0.06]).tolist()
    places = [(x, y), (-x, y), (-x, -y), (x, -y)]
    return "\n".join(
        f'<geom name="foot_{i}" type="sphere" size="{radius!r}" pos="{px!r} {py!r} {radius!r}" mass="0"'
        f' surfacevel="1 0 0 0 0 0"/>'
        for i, (px, py) in enumerate(places)
    )
