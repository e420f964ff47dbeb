"""A world with any number of robots, people, doors and docks, stepped once for all by whoever asks first.

The frame `world` is that of the world's author. Everything happens at whole ticks of 5 ms after the start, so that the same run comes
out however its askers cut time into steps. All chance comes from generators named by the seed and what they are for: another robot,
or another sensor, changes nobody's noise.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.approach import ApproachMemory
from ambler.sim.base import Physics, PlacedRobot, Touch
from ambler.sim.body import TICK, TICK_NS, Body
from ambler.sim.faults import OF_WORLD, Fault, FaultInjector, FaultKind, world_with_faults
from ambler.sim.kinematic_physics import KinematicPhysics
from ambler.sim.lidar import NO_MOVERS, Movers
from ambler.sim.movers import UPDATE_NS, Crowd
from ambler.sim.scene import build_scene, primitive
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec

NAME = re.compile(r"[A-Za-z0-9_.-]+")
SEED_STEP = 1_000_003


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """How to simulate: `physics` contact (MuJoCo) or kinematic; `is_perfect` turns noise, losses, slip and drift off. `faults` that
    concern a sensor or wheels concern those of every robot."""

    seed: int = 0
    is_perfect: bool = False
    physics: Literal["contact", "kinematic"] = "contact"
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True)
class BodySpec:
    """A robot to be put into a world: `start` in the world's frame (None: the world's start), the `seed` of its noise (None: the world's
    own for the first robot, others for the next), and faults of this robot alone."""

    name: str
    robot: SimRobot
    start: SE2 | None = None
    seed: int | None = None
    faults: tuple[Fault, ...] = ()


class TickingDevice(Protocol):
    """A device that measures when its time has come; `due_ns` counts from the world's begin."""

    due_ns: int

    def sense(self) -> None:
        """Measure now and say when to measure next."""
        ...


class World:
    """Owns the physics and everything that moves. Two with the same arguments and commands give equal bits.

    `lock` guards it: in a live run the nodes of several devices ask at once. Raises BadInputError for faults that do not fit, and for
    names that are not unique or not made of letters, digits, `_`, `.` and `-`.
    """

    def __init__(self, spec: WorldSpec, bodies: Sequence[BodySpec], config: SimulationConfig | None = None) -> None:
        self.config = config = config if config is not None else SimulationConfig()
        _check_names(bodies)
        robots = [replace(b.robot, strafe_loss=0.0) if config.is_perfect else b.robot for b in bodies]
        starts = [b.start if b.start is not None else spec.start for b in bodies]
        placed = [PlacedRobot(b.name, r, s) for b, r, s in zip(bodies, robots, starts, strict=True)]
        home = replace(spec, start=starts[0]) if starts else spec
        injectors = [FaultInjector((*config.faults, *b.faults), home, b.robot.faulty_frames) for b in bodies]
        self._faults = FaultInjector([f for f in config.faults if f.kind in OF_WORLD], home, ())
        home = world_with_faults(home, config.faults, config.seed, starts or None)
        self.spec = spec = replace(home, start=spec.start)
        self._crowd = Crowd(spec, config.seed, [p.start.transform(p.robot.model.footprint) for p in placed])
        self._physics = _make_physics(spec, placed, config.physics, self._crowd)
        seeds = [config.seed + SEED_STEP * k if b.seed is None else b.seed for k, b in enumerate(bodies)]
        self.bodies = tuple(Body(p, s, f, spec) for p, s, f in zip(placed, seeds, injectors, strict=True))
        for k, body in enumerate(self.bodies):
            body.place(self._physics.carriage(k), self._physics.travel(k))
        hulls = [body.hull(0, 0)[0] for body in self.bodies]
        self.scene = build_scene(spec, [*self._crowd.solids, *(hulls if len(hulls) > 1 else ())])
        self.lock = threading.RLock()
        self._approaches = ApproachMemory(TICK)
        self._people = {walker.person.name: k for k, walker in enumerate(self._crowd.walkers)}
        self._start_ns: int | None = None
        self.elapsed_ns = 0
        self._has_sensed = False
        self._devices: list[TickingDevice] = []

    def body(self, name: str) -> Body:
        """Return the robot of that name; raises KeyError."""
        for body in self.bodies:
            if body.name == name:
                return body
        raise KeyError(f"the world has no robot {name!r}, only {[b.name for b in self.bodies]}")

    @property
    def crowd(self) -> Crowd:
        """The people and doors."""
        return self._crowd

    @property
    def start_ns(self) -> int:
        """When the world began; raises RuntimeError before."""
        if self._start_ns is None:
            raise RuntimeError("the world has not begun")
        return self._start_ns

    @property
    def now_ns(self) -> int:
        """Time up to which the world has been simulated."""
        return self.start_ns + self.elapsed_ns

    def attach(self, device: TickingDevice) -> None:
        """Let a device measure from now on."""
        with self.lock:
            if device not in self._devices:
                self._devices.append(device)

    def detach(self, device: TickingDevice) -> None:
        """Let a device measure no more."""
        with self.lock:
            if device in self._devices:
                self._devices.remove(device)

    def advance(self, until_ns: int) -> None:
        """Advance by whole ticks, not beyond `until_ns`; the first call says when the world begins. What is done is done: a second call
        for the same instant does nothing."""
        with self.lock:
            if self._start_ns is None:
                self._start_ns = until_ns
            while self._start_ns + self.elapsed_ns + TICK_NS <= until_ns:
                self.sense_start()
                self._tick()
                self._sense()

    def sense_start(self) -> None:
        """Let every device measure at the very begin, once; the first tick does it, too."""
        if not self._has_sensed:
            self._has_sensed = True
            self._sense()

    def movers_around(self, body: Body, ago: float) -> Movers:
        """Return the kernels' arrays of everything that moves but this robot, for rays that were sent within the last `ago` seconds."""
        crowd = self._crowd.as_rays_see_it(ago) if len(self._crowd) else NO_MOVERS
        if len(self.bodies) == 1:
            return crowd
        hulls = [b.hull(self.elapsed_ns, round(ago * 1e9)) for b in self.bodies if b is not body]
        rows = np.array([primitive(solid) for solid, _ in hulls])
        kinds = np.array([solid.shape for solid, _ in hulls], np.uint8)
        rates = np.array([rate for _, rate in hulls])
        return Movers(
            np.concatenate([crowd.prims, rows]),
            np.concatenate([crowd.kinds, kinds]),
            np.concatenate([crowd.rates, rates]),
        )

    def touches(self, body: Body) -> tuple[Touch, ...]:
        """Return the contacts of a robot in the last tick."""
        return self._physics.touches(self.bodies.index(body))

    def approach_of(self, body: Body, touch: Touch) -> float | None:
        """Return how fast the touched point of a robot moved towards a person within the last half second at most (m/s), and of a robot that
        a person has just touched how fast it drove towards anything itself; None for every other touch."""
        robot, point = self.bodies.index(body), touch.position[:2]
        person = self._people.get(touch.solid)
        if person is not None:
            return self._approaches.approach(robot, person, point)
        return self._approaches.driven_speed(robot, point) if self._approaches.is_pushed(robot) else None

    def _tick(self) -> None:
        elapsed = self.elapsed_ns
        if len(self._crowd) and elapsed % UPDATE_NS == 0:
            self._crowd.take(self._physics.people())
            self._crowd.update([b.footprint_world for b in self.bodies], self._faults, elapsed * 1e-9)
            self._physics.move(self._crowd.wishes)
        targets = [body.target(elapsed) for body in self.bodies]
        self._physics.step(targets)
        if self._people:
            robots = range(len(self.bodies))
            bases = [self._physics.carriage(k).to_se2() for k in robots]
            touched = [k for k in robots if any(t.solid in self._people for t in self._physics.touches(k))]
            self._approaches.note(bases, self._physics.people(), targets, touched)
        self.elapsed_ns = elapsed = elapsed + TICK_NS
        has_power = not self._faults.is_on(FaultKind.NO_POWER, elapsed * 1e-9)
        for k, body in enumerate(self.bodies):
            body.follow(self._physics.carriage(k), self._physics.travel(k), elapsed)
            body.charge(has_power=has_power)

    def _sense(self) -> None:
        elapsed = self.elapsed_ns
        for device in self._devices:
            if elapsed >= device.due_ns:
                device.sense()


def _check_names(bodies: Sequence[BodySpec]) -> None:
    names = [b.name for b in bodies]
    if len(set(names)) < len(names):
        raise BadInputError(f"robots of one world need names of their own, not {', '.join(names)}")
    for body in bodies:
        if not NAME.fullmatch(body.name):
            raise BadInputError(f"robot name {body.name!r}: only letters, digits and _ . - are allowed")
        wrong = [f.kind.value for f in body.faults if f.kind in OF_WORLD]
        if wrong:
            raise BadInputError(f"fault {wrong[0]} concerns the whole world, not the robot {body.name} alone")


def _make_physics(spec: WorldSpec, robots: Sequence[PlacedRobot], physics: str, crowd: Crowd) -> Physics:
    masses = [walker.person.mass for walker in crowd.walkers]
    if physics == "kinematic":
        return KinematicPhysics(spec, robots, TICK, crowd.solids, masses)
    try:
        from ambler.sim.contact_physics import ContactPhysics
    except ModuleNotFoundError as error:
        raise BadInputError("contact physics needs MuJoCo (the extra `sim`); or choose kinematic physics") from error
    return ContactPhysics(spec, robots, TICK, crowd.solids, masses)
