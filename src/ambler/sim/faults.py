"""Faults on demand: what goes wrong, when, and with what, written `kind[@target][:begin[:end]]` with seconds after the start.

wheel_slip       wheels (legs) turn as told, but the base moves only 70 % of that way; odometry does not know
scanner_dropout  a scanner (or transducer, or depth camera) sends nothing; the target is its frame, `all`, or the first one
scanner_stuck    a scanner sends its last measurement again and again, with new stamps
delayed_stamps   a scanner's messages come 0.2 s late and are stamped as if they had been measured then
people           three people more, who walk straight ways chosen by the seed, far from the start; they stand outside of the time. The target
                 says how many, and how many of them do not yield to robots: `people@10`, `people@10/5` (otherwise half, or one more)
door             a sliding door closes (the target's name, or the one nearest to the start) and opens again at the end
light            the light before the camera swells and fades between full and a quarter of it
shadow           a shadow's edge wanders over the picture
blur             the camera's lens is out of focus
occlusion        a board hides half of a dock's first marker
marker_missing   a dock's first marker is not there
unmarked         docks have lost all that they are recognized by: no markers, no V shape, dull reflectors; from the start to the end
no_power         docks have contact but no current
dust             dust goes along with the robot: so many per cent of a scanner's returns are false (`dust@30`, 30 without a number)
smoke            a column of smoke, 2.4 m wide and 3 m high, stands at `smoke@X,Y` (metres, in the frame of the world's start; 4 m ahead without)
rain             drops all around, as `dust@15` (10 % without a number)
glass            two panels of wall become glass, which light passes and robots do not; from the start to the end of the run
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.messages import Image, LaserScan, PointCloud, Range
from ambler.core.se2 import SE2
from ambler.sim.air import Air, Airborne
from ambler.sim.dock_body import without_marks
from ambler.sim.sensors import named_generator
from ambler.sim.solids import Door, Person, Shape, Solid, WorldSpec
from ambler.sim.truth import reachable_cells

SLIP = 0.3  # share of the wheels' way that is lost
STAMP_DELAY = 0.2  # seconds
PEOPLE = 3
WAY_LENGTH = (3.0, 9.0)  # metres of a person's way
WAY_ROOM = 0.4  # metres from its middle to any wall
START_ROOM = 1.6  # metres that everybody keeps from the start pose
PANEL = (1.6, 2.0)  # width and height of a glass panel
PANELS = 2
FAULT_PERSON = "passer_"
SMOKE_AHEAD = [4.0, 0.0]  # metres from the world's start


class FaultKind(enum.Enum):
    """What can go wrong."""

    WHEEL_SLIP = "wheel_slip"
    SCANNER_DROPOUT = "scanner_dropout"
    SCANNER_STUCK = "scanner_stuck"
    DELAYED_STAMPS = "delayed_stamps"
    PEOPLE = "people"
    DOOR = "door"
    GLASS = "glass"
    DUST = "dust"
    SMOKE = "smoke"
    RAIN = "rain"
    LIGHT = "light"
    SHADOW = "shadow"
    BLUR = "blur"
    OCCLUSION = "occlusion"
    MARKER_MISSING = "marker_missing"
    UNMARKED = "unmarked"
    NO_POWER = "no_power"


OF_SCANNERS = (FaultKind.SCANNER_DROPOUT, FaultKind.SCANNER_STUCK, FaultKind.DELAYED_STAMPS)
OF_AIR = (FaultKind.DUST, FaultKind.SMOKE, FaultKind.RAIN)
TARGETED = (*OF_SCANNERS, *OF_AIR, FaultKind.DOOR, FaultKind.PEOPLE)
SHARE_OF = {FaultKind.DUST: 0.3, FaultKind.RAIN: 0.1}
LASTING = (FaultKind.GLASS, FaultKind.UNMARKED)
OF_WORLD = (FaultKind.PEOPLE, FaultKind.DOOR, FaultKind.GLASS, FaultKind.UNMARKED, FaultKind.NO_POWER)
Measurement = LaserScan | PointCloud | Range | Image
S = TypeVar("S", LaserScan, PointCloud, Range, Image, LaserScan | PointCloud)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault between two times, in seconds after the start of the simulation."""

    kind: FaultKind
    begin: float = 0.0
    end: float = math.inf
    target: str = ""

    @classmethod
    def parse(cls, text: str) -> Fault:
        """Read `kind[@target][:begin[:end]]`; raises BadInputError."""
        name, *times = text.split(":")
        name, _, target = name.partition("@")
        try:
            kind = FaultKind(name)
        except ValueError as error:
            known = ", ".join(k.value for k in FaultKind)
            raise BadInputError(f"fault {text!r}: no such kind {name!r}; there are {known}") from error
        try:
            values = [float(t) for t in times]
        except ValueError as error:
            raise BadInputError(f"fault {text!r}: times are seconds, as in {name}:10:20") from error
        begin, end = (values + [0.0, math.inf][len(values) :])[:2] if len(values) <= 2 else (math.nan, math.nan)
        if not 0.0 <= begin < end:
            raise BadInputError(f"fault {text!r}: it must be kind[@target][:begin[:end]] with 0 <= begin < end")
        if target and kind not in TARGETED:
            raise BadInputError(f"fault {text!r}: {name} has no target")
        if kind in LASTING and times:
            raise BadInputError(f"fault {text!r}: {name} lasts from the start to the end, without times")
        if kind is FaultKind.PEOPLE:
            numbers_of_people(target)
        if kind in OF_AIR:
            air_of(kind, target, SE2())
        return cls(kind, begin, end, target)

    def is_on(self, seconds: float) -> bool:
        """Tell whether the fault holds at a time after the start."""
        return self.begin <= seconds < self.end


class FaultInjector:
    """Applies faults; asked at every tick and for every measurement of a scanner. `frames` are the scanners of the robot that they
    concern; the world itself has one without any."""

    def __init__(self, faults: Sequence[Fault], world: WorldSpec, frames: Sequence[str]) -> None:
        self._faults = tuple(faults)
        self._frames = tuple(frames)
        self._doors = {f: find_door(world, f.target).name for f in faults if f.kind is FaultKind.DOOR}
        self._last: dict[str, Measurement] = {}
        self._airs = [(f, air_of(f.kind, f.target, world.start)) for f in faults if f.kind in OF_AIR]
        self._targets = {f: self._frames_of(f) for f in faults if f.kind in OF_SCANNERS}

    @property
    def has_slip(self) -> bool:
        return any(f.kind is FaultKind.WHEEL_SLIP for f in self._faults)

    def slip(self, seconds: float) -> float:
        """Return the share of the wheels' way that is lost now."""
        return SLIP if self.is_on(FaultKind.WHEEL_SLIP, seconds) else 0.0

    def are_people_walking(self, seconds: float) -> bool:
        """Tell whether the people of the fault walk; those of the world always do."""
        return self.is_on(FaultKind.PEOPLE, seconds)

    def is_closing(self, door: str, seconds: float) -> bool:
        """Tell whether a door shall be closed."""
        return any(f.is_on(seconds) for f, name in self._doors.items() if name == door)

    def pass_on(self, message: S, seconds: float) -> tuple[S, float] | None:
        """Return what a scanner sends instead of its measurement, and how many seconds late; None while it is silent."""
        frame = message.frame
        if self._hits(FaultKind.SCANNER_STUCK, frame, seconds):
            message = replace(cast("S", self._last.get(frame, message)), stamp_ns=message.stamp_ns)
        self._last[frame] = message
        if self._hits(FaultKind.SCANNER_DROPOUT, frame, seconds):
            return None
        if self._hits(FaultKind.DELAYED_STAMPS, frame, seconds):
            return replace(message, stamp_ns=message.stamp_ns + round(STAMP_DELAY * 1e9)), STAMP_DELAY
        return message, 0.0

    def airs(self, seconds: float) -> tuple[Air, ...]:
        """Return what floats in the air now."""
        return tuple(air for fault, air in self._airs if fault.is_on(seconds))

    def is_on(self, kind: FaultKind, seconds: float) -> bool:
        """Tell whether a fault of this kind holds now."""
        return any(f.kind is kind and f.is_on(seconds) for f in self._faults)

    def _hits(self, kind: FaultKind, frame: str, seconds: float) -> bool:
        return any(f.kind is kind and f.is_on(seconds) and frame in frames for f, frames in self._targets.items())

    def _frames_of(self, fault: Fault) -> tuple[str, ...]:
        if fault.target == "all":
            return self._frames
        target = fault.target or self._frames[0]
        if target not in self._frames:
            raise BadInputError(f"fault {fault.kind.value}: no scanner {target!r}; there are {', '.join(self._frames)}")
        return (target,)


def numbers_of_people(target: str) -> tuple[int, int]:
    """Return how many people the target `N` or `N/M` of the fault `people` means, and how many of them do not yield; raises BadInputError."""
    if not target:
        return PEOPLE, (PEOPLE + 1) // 2
    count, _, stubborn = target.partition("/")
    if not count.isdecimal() or not (stubborn or count).isdecimal() or int(count) < 1 or target.endswith("/"):
        raise BadInputError(f"fault people@{target}: people@N or people@N/M, M of N people do not yield")
    people = int(count)
    unyielding = int(stubborn) if stubborn else (people + 1) // 2
    if unyielding > people:
        raise BadInputError(f"fault people@{target}: only {people} people can be told not to yield")
    return people, unyielding


def air_of(kind: FaultKind, target: str, start: SE2) -> Air:
    """Return what a fault of the air means: `target` is per cent of the returns, or for smoke `X,Y` in the frame of `start`; raises BadInputError."""
    try:
        values = [float(text) for text in target.split(",")] if target else []
    except ValueError:
        values = [math.nan]
    wanted = 2 if kind is FaultKind.SMOKE else 1
    if values and (len(values) != wanted or not all(map(math.isfinite, values))):
        form = "smoke@X,Y, metres from the start" if wanted == 2 else f"{kind.value}@N, per cent of the returns"
        raise BadInputError(f"fault {kind.value}@{target}: {form}")
    if kind is FaultKind.SMOKE:
        x, y = start.transform(np.array([values or SMOKE_AHEAD])).tolist()[0]
        return Air(Airborne.SMOKE, columns=((x, y),))
    return Air(Airborne(kind.value), 0.01 * values[0] if values else SHARE_OF[kind])


def find_door(world: WorldSpec, name: str) -> Door:
    """Return the door of that name, or without a name the one nearest to the world's start; raises BadInputError."""
    if not world.doors:
        raise BadInputError(f"fault door: world {world.name} has no door that could close")
    if not name:
        return min(world.doors, key=lambda d: world.start.distance_to(d.leaf.world_from_solid))
    for door in world.doors:
        if door.name == name:
            return door
    known = ", ".join(d.name for d in world.doors)
    raise BadInputError(f"fault door: world {world.name} has no door {name!r}; there are {known}")


def world_with_faults(
    world: WorldSpec, faults: Sequence[Fault], seed: int, starts: Sequence[SE2] | None = None
) -> WorldSpec:
    """Return the world with its glass panels, without the marks of its docks, and with more people, who keep away from where robots
    start (None: at the world's start); only doors that a fault closes can move."""
    starts = starts if starts is not None else (world.start,)
    kinds = {f.kind for f in faults}
    if FaultKind.GLASS in kinds:
        world = replace(world, solids=_with_panels(world, seed))
    if FaultKind.UNMARKED in kinds:
        docks = tuple(replace(dock, markers=(), v_shape=None, reflectors=()) for dock in world.docks)
        world = replace(world, solids=without_marks(world.solids, world.docks), docks=docks)
    crowds = [f.target for f in faults if f.kind is FaultKind.PEOPLE]
    if crowds:
        world = replace(world, people=world.people + _people(world, seed, starts, crowds[0]))
    closing = {find_door(world, f.target).name for f in faults if f.kind is FaultKind.DOOR}
    return replace(world, doors=tuple(d for d in world.doors if d.name in closing))


def _with_panels(world: WorldSpec, seed: int) -> tuple[Solid, ...]:
    """Cut panels of glass into the long pieces of wall, chosen by the seed."""
    rng = named_generator(seed, "glass")
    long = [
        k for k, s in enumerate(world.solids) if s.shape is Shape.BOX and s.z_min == 0.0 and s.size_x >= PANEL[0] + 0.6
    ]
    if not long:
        raise BadInputError(f"fault glass: world {world.name} has no wall that is long enough for a panel")
    chosen = {int(k) for k in rng.permutation(long)[:PANELS]}
    out: list[Solid] = []
    for k, solid in enumerate(world.solids):
        out += _cut_panel(solid) if k in chosen else [solid]
    return tuple(out)


def _cut_panel(wall: Solid) -> list[Solid]:
    rest, top = 0.5 * (wall.size_x - PANEL[0]), min(PANEL[1], wall.z_max)

    def piece(x: float, length: float, low: float, high: float) -> Solid:
        return replace(
            wall, world_from_solid=wall.world_from_solid @ SE2(x, 0.0, 0.0), size_x=length, z_min=low, z_max=high
        )

    side = 0.5 * (PANEL[0] + rest)
    panel = replace(piece(0.0, PANEL[0], 0.0, top), name=f"{wall.name}_glass", size_y=0.02, is_glass=True)
    out = [piece(-side, rest, 0.0, wall.z_max), panel, piece(side, rest, 0.0, wall.z_max)]
    return out if top >= wall.z_max else [*out, piece(0.0, PANEL[0], top, wall.z_max)]


def _people(world: WorldSpec, seed: int, starts: Sequence[SE2], target: str) -> tuple[Person, ...]:
    """Choose straight ways through free space that can be reached from the world's start, far from where robots start, and who yields."""
    wanted, stubborn = numbers_of_people(target)
    unyielding = {int(k) for k in named_generator(seed, "yields").permutation(wanted)[:stubborn]}
    people = [
        Person(f"{FAULT_PERSON}{k}", way, speed=speed, yields=k not in unyielding)
        for k, (way, speed) in enumerate(_ways(world, seed, starts, wanted))
    ]
    if len(people) < (wanted if target else 1):
        room = f"room for {len(people)} people only" if people else "no room for people to walk"
        raise BadInputError(f"fault people: world {world.name} has {room}")
    return tuple(people)


def people_that_fit(world: WorldSpec, seed: int, starts: Sequence[SE2], wanted: int) -> int:
    """Return for how many of so many people more the fault `people` finds a way to walk; it looks for fewer less long."""
    found = len(_ways(world, seed, starts, wanted))
    return found if found in (0, wanted) else people_that_fit(world, seed, starts, found)


Way = tuple[tuple[float, float], tuple[float, float]]


def _ways(world: WorldSpec, seed: int, starts: Sequence[SE2], wanted: int) -> list[tuple[Way, float]]:
    """Draw the ends of up to `wanted` ways, and how fast each is walked (m/s)."""
    rng = named_generator(seed, "people")
    home = world.from_start()
    keep_clear = np.array([[p.x, p.y] for p in (world.start.inverse() @ start for start in starts)])
    spec, clear = reachable_cells(home, WAY_ROOM, 0.1, 0.5)
    cells = np.argwhere(clear)
    ways: list[tuple[Way, float]] = []
    for _ in range(4000 * max(1, wanted // PEOPLE)):
        if len(ways) == wanted or len(cells) == 0:
            break
        (ay, ax), (by, bx) = cells[rng.integers(len(cells), size=2)]
        a, b = spec.center_of(int(ay), int(ax)), spec.center_of(int(by), int(bx))
        line = np.linspace(a, b, max(2, int(math.dist(a, b) / 0.05)))
        index = spec.cells_of(line)
        gaps = np.hypot(*(line[:, None] - keep_clear).T)
        is_free = bool(clear[index[:, 0], index[:, 1]].all()) and gaps.min() > START_ROOM
        if is_free and WAY_LENGTH[0] <= math.dist(a, b) <= WAY_LENGTH[1]:
            ends = world.start.transform(np.array([a, b])).tolist()
            way = ((ends[0][0], ends[0][1]), (ends[1][0], ends[1][1]))
            ways.append((way, float(rng.uniform(0.8, 1.3))))
    return ways
