"""What moves by itself: people on their ways and sliding doors.

Half of all people yield: they halt half a metre before a robot, wait, and after some seconds turn round and walk back. The others
walk on as if there were no robot, and into it; the physics says how far they get (`Crowd.take`). Who does not get on for some
seconds turns round. Nobody steps aside for a robot, and somebody who stands in the way is the robot's problem. Each other they pass, shoulder
to shoulder, as if the other were not there: who halted for everybody would be, with the next one, a wall across a corridor for ever. A door
stops while anybody is in the way of its leaf.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.faults import FAULT_PERSON, FaultInjector
from ambler.sim.lidar import Movers
from ambler.sim.scene import primitive
from ambler.sim.sensors import named_generator
from ambler.sim.solids import Door, Person, Shape, Solid, WorldSpec

F64 = NDArray[np.float64]
UPDATE_NS = 20_000_000
DT = UPDATE_NS * 1e-9
PERSON_GAP = 0.5  # metres that a walking person keeps from the robot; at first everybody does
DOOR_GAP = 0.2  # that the leaf of a door keeps
FAR_OFF = 5.0  # metres from a corner of the robot at which nobody need look more closely
PATIENCE = 4.0  # seconds of waiting before a person turns round
HELD = 0.15  # metres that a person may be behind where he wants to be; farther, something holds him
DOOR_SPEED = 0.6


class Walker:
    """One person on a closed way. Where on it, and how much faster or slower than told, is the seed's choice; whether he yields to robots
    is said by the person, or else by `yields`.

    `place(at)` is where he wants to be; `position` and `velocity` are where he is, which the physics decides."""

    def __init__(self, person: Person, seed: int, *, yields: bool = True) -> None:
        rng = named_generator(seed, person.name)
        self.person = person
        self.yields = yields if person.yields is None else person.yields
        self._corners = [*person.way, person.way[0]]
        pairs = zip(self._corners[:-1], self._corners[1:], strict=True)
        self._lengths = [math.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairs]
        self.length = sum(self._lengths)
        self.at = float(rng.uniform(0.0, self.length))
        self._speed = person.speed * float(rng.uniform(0.85, 1.15))
        self._direction = 1.0
        self._waited = 0.0
        self.velocity = (0.0, 0.0)
        self.position = self.place(self.at)
        self.wish = self.position
        """Where he wants to be."""

    def place(self, at: float) -> tuple[float, float]:
        """Return the point `at` metres along the way."""
        at %= self.length
        for (ax, ay), (bx, by), length in zip(self._corners[:-1], self._corners[1:], self._lengths, strict=True):
            if at <= length and length > 0:
                s = at / length
                return (ax + s * (bx - ax), ay + s * (by - ay))
            at -= length
        return self._corners[-1]

    def begin_away_from(self, footprints_world: Sequence[F64]) -> None:
        """Begin at the next place of the way that no robot stands at, or near; on a way without any, at the farthest."""
        places = self.at + np.arange(0.0, self.length, 0.1)
        gaps = [min(distance_to_polygon(self.place(float(at)), f) for f in footprints_world) for at in places]
        clear = np.array(gaps) - self.person.radius >= PERSON_GAP
        self.at = float(places[int(np.argmax(clear if clear.any() else gaps))]) % self.length
        self.position = self.wish = self.place(self.at)

    def update(self, footprints_world: Sequence[F64]) -> None:
        """Walk for one period, or wait if the next step leads too near to a robot."""
        here, there = self.wish, self.place(self.at + self._direction * self._speed * DT)
        gap, radius = PERSON_GAP, self.person.radius
        is_blocked = math.dist(self.position, here) > HELD
        for footprint in footprints_world if self.yields else ():
            if math.hypot(here[0] - footprint[0, 0], here[1] - footprint[0, 1]) < FAR_OFF:
                now, then = (distance_to_polygon(p, footprint) - radius for p in (here, there))
                is_blocked |= then < gap and then < now
        if is_blocked:
            self._waited += DT
            if self._waited >= PATIENCE:
                self._waited, self._direction = 0.0, -self._direction
                self._turn_back()
            return
        self._waited = max(0.0, self._waited - DT)  # who gets on by inches is held all the same
        self.at = (self.at + self._direction * self._speed * DT) % self.length
        self.wish = self.place(self.at)

    def take(self, position: tuple[float, float]) -> None:
        """Be where the physics has let one get to within a period."""
        (x0, y0), (x1, y1) = self.position, position
        self.position, self.velocity = position, ((x1 - x0) / DT, (y1 - y0) / DT)

    def _turn_back(self) -> None:
        """Want no more what was out of reach: the place of the way nearest to where one is, as far as one may lag behind."""
        reach = np.arange(-2.0 * HELD, 2.0 * HELD + 1e-9, 0.02)
        away = [math.dist(self.position, self.place(self.at + float(step))) for step in reach]
        self.at = (self.at + float(reach[int(np.argmin(away))])) % self.length
        self.wish = self.place(self.at)


class SlidingDoor:
    """One door; `is_closing` says where its leaf shall go."""

    def __init__(self, door: Door) -> None:
        self.door = door
        self.is_closing = False
        self.openness = 1.0
        self._length = math.hypot(*door.slide)
        self.velocity = (0.0, 0.0)

    @property
    def position(self) -> tuple[float, float]:
        center, (x, y) = self.door.leaf.world_from_solid, self.door.slide
        return (center.x + self.openness * x, center.y + self.openness * y)

    def update(self, footprints_world: Sequence[F64], others: Sequence[tuple[float, float]]) -> None:
        """Slide for one period; a closing leaf waits while anybody is where the closed door will be."""
        step = (-1.0 if self.is_closing else 1.0) * DOOR_SPEED * DT / self._length
        wanted = min(max(self.openness + step, 0.0), 1.0)
        if wanted < self.openness and self._is_occupied(footprints_world, others):
            wanted = self.openness
        moved = (wanted - self.openness) / DT
        self.openness = wanted
        self.velocity = (moved * self.door.slide[0], moved * self.door.slide[1])

    def _is_occupied(self, footprints_world: Sequence[F64], others: Sequence[tuple[float, float]]) -> bool:
        leaf = self.door.leaf
        half = np.array([0.5 * leaf.size_x, 0.5 * leaf.size_y]) + DOOR_GAP
        share = np.linspace(0, 1, 8)[:, None, None]
        edges = [(f + share * (np.roll(f, -1, axis=0) - f)).reshape(-1, 2) for f in footprints_world]
        people = np.array(others).reshape(-1, 2)
        local = leaf.world_from_solid.inverse().transform(np.concatenate([*edges, people]))
        return bool((np.abs(local) < half).all(axis=1).any())


class Crowd:
    """Everybody and everything that moves by itself, in one fixed order: first people, then doors. Nobody begins where robots with these footprints (N, 2)
    stand."""

    def __init__(self, world: WorldSpec, seed: int, footprints_world: Sequence[F64] = ()) -> None:
        stubborn = _who_do_not_yield(world.people, seed)
        self.walkers = [Walker(p, seed, yields=p.name not in stubborn) for p in world.people]
        for walker in self.walkers if footprints_world else ():
            walker.begin_away_from(footprints_world)
        self.doors = [SlidingDoor(d) for d in world.doors]
        self._movers: list[Walker | SlidingDoor] = [*self.walkers, *self.doors]
        self._shapes = [_person_solid(w.person) for w in self.walkers] + [d.door.leaf for d in self.doors]
        self._kinds = np.array([s.shape for s in self._shapes], np.uint8)
        self._rows = np.array([primitive(s) for s in self._shapes]).reshape(-1, 15)
        self._world = None if world.is_flat else world

    def __len__(self) -> int:
        return len(self._shapes)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """All of them as solids where they are now, in the world."""
        return tuple(
            replace(s, world_from_solid=SE2(m.position[0], m.position[1], s.world_from_solid.yaw))
            for s, m in zip(self._shapes, self._movers, strict=True)
        )

    def update(self, footprints_world: Sequence[F64], faults: FaultInjector, seconds: float) -> None:
        """Let one period pass beside robots with these footprints (N, 2); the faults tell which doors close and whether their people
        walk."""
        is_time = faults.are_people_walking(seconds)
        for walker in self.walkers:
            if is_time or not walker.person.name.startswith(FAULT_PERSON):
                walker.update(footprints_world)
        for door in self.doors:
            door.is_closing = faults.is_closing(door.door.name, seconds)
            door.update(footprints_world, [w.position for w in self.walkers])

    @property
    def wishes(self) -> list[tuple[float, float]]:
        """Where everybody wants to be, people first, then doors, which are where they want to be."""
        return [*(w.wish for w in self.walkers), *(d.position for d in self.doors)]

    def take(self, places: Sequence[tuple[float, float]]) -> None:
        """Let people be where the physics has let them get to, in their order."""
        for walker, place in zip(self.walkers, places, strict=True):
            walker.take(place)

    def as_rays_see_it(self, ago: float) -> Movers:
        """Return the kernels' arrays, `ago` seconds before now: shifted back by the present velocities."""
        rows = self._rows.copy()
        rates = np.array([m.velocity for m in self._movers]).reshape(-1, 2)
        rows[:, :2] = np.array([m.position for m in self._movers]).reshape(-1, 2) - ago * rates
        if self._world is not None:
            rows[:, 2] += ground_under(self._world, rows[:, :2])
        return Movers(rows, self._kinds, rates)


def ground_under(world: WorldSpec, points: F64) -> F64:
    """Return the heights of the ground that movers at points (N, 2) stand on, each for itself, float64 (N,)."""
    if not world.meshes:  # nobody stands above another
        return world.ground_at(points)
    return np.array([float(world.ground_at(point[None, :])[0]) for point in points])


def _who_do_not_yield(people: Sequence[Person], seed: int) -> frozenset[str]:
    """Choose half (or one more) of those of whom nothing is said."""
    open_names = [p.name for p in people if p.yields is None]
    chosen = named_generator(seed, "yields").permutation(len(open_names))[: (len(open_names) + 1) // 2]
    return frozenset(open_names[int(k)] for k in chosen)


def _person_solid(person: Person) -> Solid:
    width = 2.0 * person.radius
    return Solid(person.name, Shape.CYLINDER, SE2(*person.way[0], 0.0), width, width, 0.0, person.height, 0.5)


def distance_to_polygon(point: tuple[float, float], polygon: F64) -> float:
    """Return the distance from a point to a convex, counter-clockwise polygon (N, 2); 0 inside."""
    edge, to = np.roll(polygon, -1, axis=0) - polygon, np.array(point) - polygon
    if np.all(edge[:, 0] * to[:, 1] - edge[:, 1] * to[:, 0] >= 0):
        return 0.0
    along = np.clip(np.sum(edge * to, axis=1) / np.sum(edge * edge, axis=1), 0.0, 1.0)
    gap = to - along[:, None] * edge
    return float(np.min(np.hypot(gap[:, 0], gap[:, 1])))
