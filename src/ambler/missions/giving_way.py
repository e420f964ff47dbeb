"""Giving way: who holds the robot up is remembered with the way that he walks, until he has walked past the place where it stands aside."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import CostGrid
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.planning.refuge import RefugeConfig, Walk, find_refuge

F64 = NDArray[np.float64]
ALONE = 10.0  # seconds without anybody after which it is another meeting
TRAIL = 200  # places of the robot that are remembered, half a second apart
SAME = 0.5  # metres that somebody may be from where he was at the scan before
STEP = 0.5  # metres that tell along which line he walks
FAR = 4.0  # metres from the robot from which on he is not near
SLOW = 0.25  # m/s with which it gets aside at worst
AHEAD = 1.0  # metres along its path that tell where the robot wants to go
CELL = 0.2  # metres between places at which somebody walked that are remembered


@dataclass(frozen=True, slots=True)
class GivingWayConfig:
    """Numbers of giving way, SI.

    near            metres from the robot's outline within which somebody on its path can hold it up
    held            pairs of seconds and metres: for so long the robot must not have left a circle of so many metres, in company, before somebody
                    holds it up; who comes and goes lets it get on a little each time, and pushes it back
    tries           how often it stands aside before it has got on again; 0: never
    memory          seconds for which it is remembered where people walked, and that the robot stood aside
    past            metres that he must have come beyond the robot to be past
    gone            seconds for which he must not have been near, to have gone elsewhere; twice as long each time that the robot stands aside again
    longest         seconds of standing aside after which the robot goes on anyhow
    share, most     of the time that may be spent aside, and seconds of it that are saved up at most: among many people somebody always comes
    """

    near: float = 1.5
    held: tuple[tuple[float, float], ...] = ((8.0, 1.0), (25.0, 3.0))
    tries: int = 3
    memory: float = 60.0
    past: float = 0.6
    gone: float = 8.0
    longest: float = 25.0
    share: float = 0.2
    most: float = 75.0
    refuge: RefugeConfig = field(default_factory=RefugeConfig)

    def __post_init__(self) -> None:
        if self.tries < 0 or min(self.near, self.memory, self.gone, self.longest, self.share, self.most) <= 0.0:
            raise BadInputError("giving way: lengths and times must be positive, tries not negative")
        if any(len(pair) != 2 or min(pair) <= 0.0 for pair in self.held):
            raise BadInputError("giving way: `held` must be pairs of seconds and metres, all positive")


@dataclass(frozen=True, slots=True, eq=False)
class _Walker:
    """Somebody: where he is, where he was when `along`, the unit vector along which he last walked, was told; None: he has not walked yet."""

    number: int
    place: F64
    since: F64
    along: F64 | None = None

    def at(self, place: F64) -> _Walker:
        """Return him at another place."""
        step = place - self.since
        length = float(np.hypot(*step))
        if length < STEP:
            return replace(self, place=place)
        return _Walker(self.number, place, place, step / length)


class _Allowance:
    """Seconds that may be spent: a share of the time that passes is saved up, to so many at most, with which it begins."""

    def __init__(self, share: float, most: float) -> None:
        self._share, self._most = share, most
        self._left, self._since_ns, self._is_spending = most, 0, False

    def at(self, now_ns: int) -> float:
        """Return how much is left."""
        rate = -1.0 if self._is_spending else self._share
        return max(0.0, min(self._most, self._left + rate * 1e-9 * (now_ns - self._since_ns)))

    @property
    def is_spending(self) -> bool:
        """Whether it is spent now."""
        return self._is_spending

    def set(self, now_ns: int, *, is_spending: bool) -> None:
        """Begin to spend, or to save."""
        self._left, self._since_ns, self._is_spending = self.at(now_ns), now_ns, is_spending


class GivingWay:
    """Where people walk near one robot, and whether it may go on; all places are in the map frame."""

    def __init__(self, config: GivingWayConfig, robot: RobotModel) -> None:
        self._config = config
        self._robot = robot
        self._walkers: list[_Walker] = []
        self._count = 0
        self._walked: dict[tuple[int, int], int] = {}
        self._trail: deque[tuple[int, float, float]] = deque(maxlen=TRAIL)  # where the robot was in company
        self._idle_since_ns: int | None = None
        self._who = -1  # the number of whom it stands aside for
        self._near_ns = self._begun_ns = self._until_ns = 0
        self._times = 0
        self._allowance = _Allowance(config.share, config.most)
        self._ahead = 0.0
        self.walk: Walk | None = None
        """Along which line he comes for whom it stands aside, None before the first."""

    def meet(self, now_ns: int, places: F64, map_from_base: SE2) -> None:
        """Take where people are now, float64 (K, 2)."""
        places = places[np.isfinite(places).all(axis=1)]
        self._note(now_ns, map_from_base)
        self._walkers = [self._walker_at(place) for place in places]
        for x, y in places:
            self._walked[(math.floor(x / CELL), math.floor(y / CELL))] = now_ns
        him = self._him()
        if him is not None and math.hypot(him.place[0] - map_from_base.x, him.place[1] - map_from_base.y) < FAR:
            self._near_ns = now_ns

    def rest(self) -> None:
        """Take that the robot is not to move: nobody holds it up meanwhile."""
        self._trail.clear()

    def take_idle(self, now_ns: int, *, is_idle: bool) -> None:
        """Take whether anything is to be done now: between two drives nobody holds the robot up, and who did so before still does after."""
        if is_idle and self._idle_since_ns is None:
            self._idle_since_ns = now_ns
        elif not is_idle and self._idle_since_ns is not None:
            gap_ns, self._idle_since_ns = now_ns - self._idle_since_ns, None
            is_over = not self._trail or now_ns - self._trail[-1][0] > ALONE * 1e9
            trail = [] if is_over else [(t + gap_ns, x, y) for t, x, y in self._trail]
            self._trail = deque(trail, maxlen=TRAIL)

    def forget(self) -> None:
        """Take that the robot is elsewhere: on another level of the map."""
        self._trail.clear()
        self._walkers.clear()
        self._walked.clear()

    def end(self, now_ns: int) -> None:
        """Take that the robot does not stand aside, any more or at all: whoever meets it now holds it up anew."""
        if self._allowance.is_spending:
            self._allowance.set(now_ns, is_spending=False)
            self._trail.clear()

    def is_held_up(self, now_ns: int, map_from_base: SE2, path: F64 | None) -> bool:
        """Whether the robot does not get on and somebody stands or walks right before it: on its path `path`, float64 (N, >= 2), ahead, or anywhere around a robot without one. From who comes from behind it gets away by driving on."""
        if self._idle_since_ns is not None or self._allowance.at(now_ns) < self._config.longest:
            return False
        gets_on = not any(self._has_stayed(now_ns, map_from_base, *pair) for pair in self._config.held)
        return not gets_on and self._before(map_from_base, path) is not None

    def seek(
        self, now_ns: int, map_from_base: SE2, path: F64 | None, costs: CostGrid
    ) -> Callable[[], SE2 | None] | None:
        """Return the search, to be done in the background, for where to stand aside for who holds the robot up, which gives None where there is no such place; None while nobody does."""
        him = self._before(map_from_base, path)
        if him is None:
            return None
        self._times = 1 if now_ns - self._begun_ns > self._config.memory * 1e9 else self._times + 1
        self._begun_ns = self._near_ns = now_ns
        self._set_end(now_ns, self._config.refuge.reach)
        self._ahead = math.inf
        self._allowance.set(now_ns, is_spending=True)
        self._who = him.number
        self.walk = walk = self._walk_of(him, now_ns, map_from_base)
        args = (costs.data, costs.spec, map_from_base, self._robot, walk, self._config.refuge)
        return partial(find_refuge, *args)

    def go_to(self, now_ns: int, map_from_base: SE2, refuge: SE2) -> None:
        """Take where the robot goes to stand aside."""
        if self.walk is not None:
            corners = refuge.transform(np.asarray(self._robot.footprint, np.float64))
            self._ahead = float(self.walk.lengthwise(corners).max())
        self._set_end(now_ns, map_from_base.distance_to(refuge))

    def _set_end(self, now_ns: int, metres: float) -> None:
        """Set when it goes on at the latest: so many metres lead to where it stands aside."""
        self._until_ns = now_ns + round(1e9 * (self._config.longest + metres / SLOW))

    def is_over(self, now_ns: int) -> bool:
        """Whether the robot may leave its place: he is past, he has not been near for long, or it has stood there for very long."""
        c, walk, him = self._config, self.walk, self._him()
        gone = c.gone * 2.0 ** (self._times - 1)
        is_past = walk is not None and him is not None and walk.lengthwise(him.place[None])[0] > self._ahead + c.past
        is_over = walk is None or is_past or now_ns > self._until_ns or now_ns - self._near_ns > gone * 1e9
        if is_over:
            self.end(now_ns)
        return bool(is_over)

    def _note(self, now_ns: int, map_from_base: SE2) -> None:
        """Remember where the robot is in company, unless there is nothing to do; another meeting begins anew."""
        if self._idle_since_ns is not None:
            return
        if self._trail and now_ns - self._trail[-1][0] > ALONE * 1e9:
            self._trail.clear()
        if not self._trail or now_ns - self._trail[-1][0] >= 0.5e9:
            self._trail.append((now_ns, map_from_base.x, map_from_base.y))

    def _has_stayed(self, now_ns: int, map_from_base: SE2, seconds: float, metres: float) -> bool:
        """Whether the robot has been in company, and within so many metres of its place, for so long."""
        begin_ns = now_ns - round(seconds * 1e9)
        before = [place for place in self._trail if place[0] <= begin_ns]
        since = [place for place in self._trail if place[0] > begin_ns]
        here = (map_from_base.x, map_from_base.y)
        return bool(before) and all(math.dist((x, y), here) <= metres for _, x, y in (before[-1], *since))

    def _him(self) -> _Walker | None:
        """Return for whom it stands aside, None while he is not seen."""
        return next((w for w in self._walkers if w.number == self._who), None)

    def _before(self, map_from_base: SE2, path: F64 | None) -> _Walker | None:
        """Return who is right before the robot, and nearest to it."""
        near, here = self._config.near, np.array((map_from_base.x, map_from_base.y))
        walkers = sorted(self._walkers, key=lambda w: float(np.hypot(*(w.place - here))))
        if len(walkers) == 0:
            return None
        places = np.array([w.place for w in walkers])
        is_before = self._gaps(map_from_base, places) <= near
        if path is not None and len(path) > 0:
            ahead = path[int(np.argmin(np.hypot(*(path[:, :2] - here).T))) :, :2]
            ahead = ahead[np.hypot(*(ahead - ahead[0]).T) <= near + self._robot.circumscribed_radius]
            is_far = np.hypot(*(ahead - here).T) >= AHEAD
            towards = ahead[int(np.argmax(is_far)) if is_far.any() else -1] - here
            aside = np.hypot(*(places[:, None] - ahead[None]).transpose(2, 0, 1)).min(axis=1)
            is_before &= (places - here) @ towards > 0.0
            is_before &= aside <= self._robot.inscribed_radius + self._config.refuge.least
        return walkers[int(np.argmax(is_before))] if is_before.any() else None

    def _gaps(self, map_from_base: SE2, places: F64) -> F64:
        """Return how far places (K, 2) are from the robot's bounding box, (K,)."""
        corners = np.asarray(self._robot.footprint)
        local = map_from_base.inverse().transform(places)
        outside = np.maximum(np.maximum(corners.min(axis=0) - local, local - corners.max(axis=0)), 0.0)
        return np.asarray(np.hypot(*outside.T))

    def _walker_at(self, place: F64) -> _Walker:
        """Return who is at a place now: whoever was nearest to it a moment ago, or somebody new."""
        him = min(self._walkers, key=lambda w: float(np.hypot(*(w.place - place))), default=None)
        if him is not None and np.hypot(*(him.place - place)) <= SAME:
            return him.at(place)
        self._count += 1
        return _Walker(self._count, place, place)

    def _walk_of(self, him: _Walker, now_ns: int, map_from_base: SE2) -> Walk:
        """Return somebody's way: along the line on which he walked last, towards the robot."""
        self._walked = {k: t for k, t in self._walked.items() if now_ns - t <= self._config.memory * 1e9}
        walked = CELL * (np.array(list(self._walked), np.float64).reshape(-1, 2) + 0.5)
        to = np.array((map_from_base.x, map_from_base.y)) - him.place
        along = to / max(1e-6, float(np.hypot(*to))) if him.along is None else him.along
        if float(along @ to) < 0.0:
            along = -along
        return Walk((float(him.place[0]), float(him.place[1])), (float(along[0]), float(along[1])), walked)
