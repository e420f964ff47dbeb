"""Whether a robot that makes its map still knows where it is in it: enough returns to tell, and no contradiction with what it has mapped.

A scan without returns says nothing of the place; one that fits what was seen last much worse than usual, and whose returns lie where the map
is free, says that the pose is wrong. In both cases nothing may be drawn into the map: walls would be erased by rays from a place where the robot is
not. A scan that fits what was seen last as well as usual is right even where it contradicts older parts: it is for loop closure to bend them.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
from ambler.core.se2 import SE2


class MapTrust(enum.Enum):
    """GOOD: the map grows. DEGRADED: it does not, the pose goes on by odometry. LOST: that has gone on for too long."""

    GOOD = "good"
    DEGRADED = "degraded"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class MapTrustConfig:
    """A scan says too little with fewer than `least_returns` returns: the matcher takes ten, and a wall of which twenty are seen fixes two
    directions of three. It contradicts the map when more than `most_contradicting` of its returns lie on floor that the map calls free, more
    than `slack` (m) from anything occupied: of returns on known cells, at least as many as `least_returns`. People and doors are a few percent, ten
    people close by a third; with a pose that is off by half a metre the walls ahead lie on free floor and those behind on unknown cells. It counts only where the match
    scores at least `score_drop` less than matches of late, which follow with the share `score_gain` of each. Doubt of `doubt_time` s in a row degrades, agreement of `sure_time` s
    restores; the map is lost after `lost_way` metres or `lost_time` s of doubt."""

    least_returns: int = 20
    most_contradicting: float = 0.6
    slack: float = 0.2
    score_drop: float = 0.2
    score_gain: float = 0.02
    doubt_time: float = 2.0
    sure_time: float = 1.0
    lost_way: float = 8.0
    lost_time: float = 30.0

    def __post_init__(self) -> None:
        if not 0.0 < self.most_contradicting <= 1.0 or self.least_returns < 0:
            raise BadInputError("map trust: a share must lie in (0, 1], a count must not be negative")


class KnownFloor:
    """The cells of a map that are free and lie well away from anything occupied. They are judged where returns lie, and only then: a hall has millions."""

    def __init__(self, spec: GridSpec, occupancy: NDArray[np.int8], slack: float) -> None:
        self.spec = spec
        self._occupancy = occupancy
        self._reach = max(1, math.ceil(slack / spec.resolution))

    def contradiction(self, points_map: NDArray[np.floating]) -> tuple[float, int]:
        """Return the share of returns (N, 2) that lie on such floor, of those on known cells, and how many these are."""
        cells = self.spec.cells_of(np.asarray(points_map, np.float64))
        height, width = self.spec.shape
        cells = cells[(cells >= 0).all(axis=1) & (cells[:, 0] < height) & (cells[:, 1] < width)]
        if len(cells) == 0:
            return 0.0, 0
        corner = np.maximum(cells.min(axis=0) - self._reach, 0)
        end = cells.max(axis=0) + self._reach + 1
        around = self._occupancy[corner[0] : end[0], corner[1] : end[1]]
        size = 2 * self._reach + 1
        near = cv2.dilate((around >= OCC_OCCUPIED).view(np.uint8), np.ones((size, size), np.uint8))
        rows, columns = (cells - corner).T
        met = around[rows, columns]
        known = int(np.count_nonzero(met >= 0))
        floor = int(np.count_nonzero((met == OCC_FREE) & (near[rows, columns] == 0)))
        return (floor / known if known else 0.0), known


class MapTrustJudge:
    """Judges scan after scan. `set_map` whenever the map changes; `may_match` before a scan is matched, `update` after."""

    def __init__(self, config: MapTrustConfig | None = None) -> None:
        self.config = config or MapTrustConfig()
        self.state = MapTrust.GOOD
        self.text = ""
        self._floor: KnownFloor | None = None
        self._doubt_ns: int | None = None
        self._sure_ns: int | None = None
        self._last: SE2 | None = None
        self._way = 0.0
        self._usual_score: float | None = None

    def set_map(self, spec: GridSpec, occupancy: NDArray[np.int8]) -> None:
        """Take the newest map, int8 [iy, ix]; one that is not made in doubt."""
        self._floor = KnownFloor(spec, occupancy, self.config.slack)

    def may_match(self, points: NDArray[np.floating]) -> bool:
        """Say whether a scan of these returns (N, 2) can tell where it is."""
        return len(points) >= self.config.least_returns

    @property
    def may_map(self) -> bool:
        """Whether scans may be drawn into the map: not from the first doubt on."""
        return self._doubt_ns is None

    def update(self, stamp_ns: int, odom_from_base: SE2, points_map: NDArray[np.floating], score: float) -> MapTrust:
        """Take a scan's returns (N, 2) at the pose that was found for it, and the match's score (0 without a match); returns the state."""
        if self._last is not None:
            self._way += self._last.distance_to(odom_from_base)
        self._last = odom_from_base
        doubt = self._doubt_of(points_map, score)
        if not doubt and score > 0.0:
            usual = score if self._usual_score is None else self._usual_score
            self._usual_score = usual + self.config.score_gain * (score - usual)
        if doubt:
            self._sure_ns = None
            if self._doubt_ns is None:
                self._doubt_ns, self._way = stamp_ns, 0.0
            self._worsen(stamp_ns, doubt)
        elif self._doubt_ns is not None:
            self._sure_ns = stamp_ns if self._sure_ns is None else self._sure_ns
            is_short = self.state is MapTrust.GOOD
            if is_short or stamp_ns - self._sure_ns >= self.config.sure_time * 1e9:
                self._doubt_ns, self._sure_ns, self.state, self.text = None, None, MapTrust.GOOD, ""
        return self.state

    def _doubt_of(self, points_map: NDArray[np.floating], score: float) -> str:
        c = self.config
        if len(points_map) < c.least_returns:
            return f"{len(points_map)} returns, too few to tell where the robot is"
        if self._floor is None or self._usual_score is None or score > self._usual_score - c.score_drop:
            return ""
        share, known = self._floor.contradiction(points_map)
        if known >= c.least_returns and share > c.most_contradicting:
            return f"{share:.0%} of the returns lie where the map is free"
        return ""

    def _worsen(self, stamp_ns: int, doubt: str) -> None:
        assert self._doubt_ns is not None
        c, seconds = self.config, (stamp_ns - self._doubt_ns) * 1e-9
        if self._way > c.lost_way or seconds > c.lost_time:
            self.state = MapTrust.LOST
            self.text = f"{doubt}, for {seconds:.0f} s and {self._way:.1f} m"
        elif self.state is MapTrust.GOOD and seconds >= c.doubt_time:
            self.state, self.text = MapTrust.DEGRADED, doubt
