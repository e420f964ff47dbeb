"""Giving way: who holds the robot up is remembered with the way that he walks, until he has walked past the place where it stands aside."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import CostGrid
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.planning.refuge import RefugeConfig, Walk, find_refuge

F64 = NDArray[np.float64]
ALONE = 2.0  # seconds without anybody after which it is another meeting
SAME = 0.5  # metres that somebody may be from where he was at the scan before
STEP = 0.5  # metres that tell along which line he walks
AHEAD = 1.0  # metres along its path that tell where the robot wants to go
CELL = 0.2  # metres between places at which somebody walked that are remembered


@dataclass(frozen=True, slots=True)
class GivingWayConfig:
    """Numbers of giving way, SI.

    near            metres from the robot's outline within which somebody on its path can hold it up
    held, place     seconds for which the robot must not have left a circle of so many metres, in his company, before he holds it up
    tries           how often it stands aside before it has got on again; 0: never
    memory          seconds for which it is remembered where people walked, and that the robot stood aside
    past            metres that he must have come beyond the robot to be past
    gone            seconds for which nobody must have been near, to have gone elsewhere; twice as long each time that the robot stands aside again
    longest         seconds after which the robot goes on anyhow
    """

    near: float = 1.5
    held: float = 8.0
    place: float = 1.0
    tries: int = 6
    memory: float = 60.0
    past: float = 0.6
    gone: float = 6.0
    longest: float = 45.0
    refuge: RefugeConfig = field(default_factory=RefugeConfig)

    def __post_init__(self) -> None:
        if self.tries < 0 or min(self.near, self.held, self.place, self.memory, self.gone, self.longest) <= 0.0:
            raise BadInputError("giving way: lengths and times must be positive, tries not negative")


@dataclass(slots=True, eq=False)
class _Walker:
    """Somebody: where he is, where he was when `along`, the unit vector along which he last walked, was told; None: he has not walked yet."""

    place: F64
    since: F64
    along: F64 | None = None

    def walk_on(self, place: F64) -> _Walker:
        """Return him at another place."""
        step = place - self.since
        length = float(np.hypot(*step))
        return _Walker(place, place, step / length) if length >= STEP else _Walker(place, self.since, self.along)


class GivingWay:
    """Where people walk near one robot, and whether it may go on; all places are in the map frame."""

    def __init__(self, config: GivingWayConfig, robot: RobotModel) -> None:
        self._config = config
        self._robot = robot
        self._places = np.zeros((0, 2))
        self._walkers: list[_Walker] = []
        self._walked: dict[tuple[int, int], int] = {}
        self._near_ns = 0
        self.walk: Walk | None = None
        """Along which line he comes for whom it stands aside, None before the first."""
        self._ahead = 0.0
        self._begun_ns = 0
        self._times = 0
        self._here = SE2()
        self._here_ns = self._met_ns = 0

    def meet(self, now_ns: int, places: F64, map_from_base: SE2) -> None:
        """Take where people are now, float64 (K, 2)."""
        self._walkers = [self._walker_at(place) for place in places]
        self._places = places
        c, was_alone = self._config, now_ns - self._met_ns > ALONE * 1e9
        if was_alone or map_from_base.distance_to(self._here) > c.place:
            self._here, self._here_ns = map_from_base, now_ns
        self._met_ns = now_ns
        for x, y in places:
            self._walked[(math.floor(x / CELL), math.floor(y / CELL))] = now_ns
        reach = self._robot.circumscribed_radius + 2.0 * c.near
        if len(places) > 0 and np.hypot(*(places - (map_from_base.x, map_from_base.y)).T).min() < reach:
            self._near_ns = now_ns

    def is_held_up(self, now_ns: int, map_from_base: SE2, path: F64 | None) -> bool:
        """Whether the robot does not get on and somebody stands or walks right before it: on its path `path`, float64 (N, >= 2), ahead, or anywhere around a robot without one. From who comes from behind it gets away by driving on."""
        if now_ns - self._here_ns < self._config.held * 1e9:
            return False
        near, here = self._config.near, np.array((map_from_base.x, map_from_base.y))
        places = self._places[self._gaps(map_from_base) <= near]
        if len(places) == 0 or path is None:
            return len(places) > 0
        ahead = path[int(np.argmin(np.hypot(*(path[:, :2] - here).T))) :, :2]
        ahead = ahead[np.hypot(*(ahead - ahead[0]).T) <= near + self._robot.circumscribed_radius]
        is_far = np.hypot(*(ahead - here).T) >= AHEAD
        towards = ahead[int(np.argmax(is_far)) if is_far.any() else -1] - here
        aside = np.hypot(*(places[:, None] - ahead[None]).transpose(2, 0, 1)).min(axis=1)
        is_ahead = (places - here) @ towards > 0.0
        return bool((is_ahead & (aside <= self._robot.inscribed_radius + self._config.refuge.least)).any())

    def _walker_at(self, place: F64) -> _Walker:
        """Return who is at a place now: whoever was nearest to it a moment ago, or somebody new."""
        near = [w for w in self._walkers if np.hypot(*(w.place - place)) <= SAME]
        if not near:
            return _Walker(place, place)
        return min(near, key=lambda w: float(np.hypot(*(w.place - place)))).walk_on(place)

    def _gaps(self, map_from_base: SE2) -> F64:
        """Return how far everybody is from the robot's bounding box, (K,)."""
        corners = np.asarray(self._robot.footprint)
        local = map_from_base.inverse().transform(self._places)
        outside = np.maximum(np.maximum(corners.min(axis=0) - local, local - corners.max(axis=0)), 0.0)
        return np.asarray(np.hypot(*outside.T))

    def seek(self, now_ns: int, map_from_base: SE2, costs: CostGrid) -> Callable[[], SE2 | None] | None:
        """Return the search, to be done in the background, for where to stand aside for who is nearest now, which gives None where there is no such place; None while nobody is there."""
        if len(self._places) == 0:
            return None
        self._times = 1 if now_ns - self._begun_ns > self._config.memory * 1e9 else self._times + 1
        self._begun_ns = self._near_ns = now_ns
        self.walk = walk = self._walk_of(now_ns, map_from_base)
        args = (costs.data, costs.spec, map_from_base, self._robot, walk, self._config.refuge)
        return partial(find_refuge, *args)

    def go_to(self, refuge: SE2) -> None:
        """Take where the robot goes to stand aside."""
        if self.walk is not None:
            corners = refuge.transform(np.asarray(self._robot.footprint, np.float64))
            self._ahead = float(self.walk.lengthwise(corners).max())

    def is_over(self, now_ns: int) -> bool:
        """Whether the robot may leave its place: he is past, nobody has been near for long, or it has stood there for very long."""
        c, walk = self._config, self.walk
        gone = c.gone * 2.0 ** (self._times - 1)
        if walk is None or now_ns - self._begun_ns > c.longest * 1e9 or now_ns - self._near_ns > gone * 1e9:
            return True
        return len(self._places) > 0 and bool((walk.lengthwise(self._places) > self._ahead + c.past).all())

    def _walk_of(self, now_ns: int, map_from_base: SE2) -> Walk:
        """Return the way of who is nearest: along the line on which he walked last, towards the robot."""
        c, here = self._config, np.array((map_from_base.x, map_from_base.y))
        self._walked = {k: t for k, t in self._walked.items() if now_ns - t <= c.memory * 1e9}
        walked = CELL * (np.array(list(self._walked), np.float64).reshape(-1, 2) + 0.5)
        walker = min(self._walkers, key=lambda w: float(np.hypot(*(w.place - here))))
        to = here - walker.place
        along = to / max(1e-6, float(np.hypot(*to))) if walker.along is None else walker.along
        if float(along @ to) < 0.0:
            along = -along
        return Walk((float(walker.place[0]), float(walker.place[1])), (float(along[0]), float(along[1])), walked)
