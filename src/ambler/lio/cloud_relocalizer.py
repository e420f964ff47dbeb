"""Where in a saved cloud is the sensor? Gravity is known, so four numbers are looked for.

Walls seen from above are searched by branch and bound for every place and heading that explains them; each is then tried at every height of the
map, walls and floors apart; the best are registered in all six degrees of freedom and judged by what they explain and contradict.
Without a guess a second viewpoint must confirm one place, and several places that look alike are said to be so.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import wrap_angle
from ambler.core.se3 import SE3
from ambler.kernels import relocalization as kernel
from ambler.lio.cloud_map import CloudMap, Image
from ambler.lio.cloud_match import CloudMatch, apart, compared, judge, register, register_coarsely, tilt_of
from ambler.lio.config import CloudMatchConfig, CloudRelocalizerConfig
from ambler.lio.sight import LaidScan, LocalCloud, Sight

F64 = NDArray[np.float64]
SECTORS = 8
WALLS_LEAST = 30
OWN_DECK = (-0.3, 1.6)  # metres above the sensor between which walls of its own deck lie
SENSOR_ABOVE = (-1.0, 4.0)  # metres that a sensor may be below the lowest and above the highest point of a map


class CloudState(enum.Enum):
    """How far the search has come."""

    GATHERING = "scans are gathered"
    NOT_FOUND = "no place of the map explains what is seen"
    VERIFYING = "one place explains what is seen; another viewpoint must confirm it"
    AMBIGUOUS = "several places look alike; another viewpoint is needed"
    FOUND = "one place explains what was seen from all viewpoints"
    TRACKING = "the place is followed in the map"
    LOST = "what is seen does not fit the place any more; it is looked for again"


@dataclass(frozen=True, slots=True, eq=False)
class CloudSearch:
    """State of the search, the places that are possible, the best first, each as the pose of `odom_from_local`'s frame, and how many viewpoints agreed."""

    state: CloudState
    matches: tuple[CloudMatch, ...]
    odom_from_local: SE3
    viewpoints: int


class CloudRelocalizer:
    """Give it the odometry's results until it answers FOUND. `guess` is map_from_imu (its roll and pitch do not count) at the first of them."""

    def __init__(
        self,
        cloud_map: CloudMap,
        config: CloudRelocalizerConfig,
        match: CloudMatchConfig,
        guess: SE3 | None = None,
    ) -> None:
        self.map, self.config, self._match, self._guess = cloud_map, config, match, guess
        self._sight = Sight(match, config.scans_most)
        self._answer = CloudSearch(CloudState.GATHERING, (), SE3(), 0)
        self._map_from_odom: SE3 | None = None
        self._are_clear = False
        self._guess_from_odom: SE3 | None = None
        self._viewpoint = SE3()
        self._next_ns = 0
        self._fresh = 0

    def update(self, result: LaidScan) -> CloudSearch:
        """Gather, search where it is time to, and say how far that has come."""
        self._sight.add(result)
        self._fresh += 1
        if self._guess is not None and self._guess_from_odom is None:
            self._guess_from_odom = _upright(self._guess) @ _upright(result.map_from_imu).inverse()
        if self._fresh < self.config.scans_least or not self._is_due(result):
            return self._answer
        local = self._sight.gathered(self.config.scans_most)
        found = self.search(local, self._window(local))
        if self._guess is not None:
            self._answer = self._believed(local, found)
        else:
            self._answer = self._confirmed(local, found, result.map_from_imu)
        self._next_ns = result.stamp_ns + round(self.config.retry_after * 1e9)
        return self._answer

    def search(self, local: LocalCloud, window: F64 | None = None) -> tuple[CloudMatch, ...]:
        """Return the places that explain a sight, the best first; `window` float64 (4,) (x, y, z, yaw) limits them to about a guess."""
        c = self.config
        walls = local.walls()
        if len(walls) < WALLS_LEAST:
            return ()
        found: list[CloudMatch] = []
        places = [self._from_above(walls, self.map.image, window)]
        if window is None:  # near a guess nothing can hide what is looked for
            level = walls[(walls[:, 2] > OWN_DECK[0]) & (walls[:, 2] < OWN_DECK[1])]
            places += [self._from_above(level, deck, None) for deck in self.map.decks if len(level) >= WALLS_LEAST]
        starts = self._at_heights(local, np.concatenate(places), window)
        tried: list[SE3] = []
        for start in starts[: c.refined * len(places)]:
            if any(self._is_same(start, other) for other in tried):
                continue
            near = register_coarsely(self.map, local, start, self._match)
            if any(self._is_same(near, other) for other in tried):
                continue
            pose = register(self.map, local, near, self._match)
            tried += [near, pose]
            off, turn = apart(start, pose)
            if off > 2.0 * self._match.coarse_reach or turn > 0.5 or tilt_of(pose) > self._match.tilt_most:
                continue
            match = judge(self.map, local, pose, self._match)
            if any(self._is_same(pose, other.map_from_local) for other in found if other.quality >= match.quality):
                continue
            found = [m for m in found if not self._is_same(pose, m.map_from_local)]
            found.append(match)
        return compared(found)

    def _is_due(self, result: LaidScan) -> bool:
        if result.stamp_ns < self._next_ns:
            return False
        if self._guess is not None or self._map_from_odom is None:
            return True
        way, turn = apart(self._viewpoint, result.map_from_imu)
        return way >= self.config.viewpoint_way or turn >= self.config.viewpoint_turn

    def _window(self, local: LocalCloud) -> F64 | None:
        if self._guess_from_odom is None:
            return None
        guess = self._guess_from_odom @ local.odom_from_local
        return np.array([*guess.translation, guess.to_se2().yaw])

    def _from_above(self, walls: F64, image: Image, window: F64 | None) -> F64:
        """Return places (K, 3): x, y, yaw whose walls from above look like those seen, the best first."""
        c = self.config
        points = _spread(walls[:, :2], image.cell, c.search_points)
        reach = float(np.percentile(np.hypot(points[:, 0], points[:, 1]), 90))
        turns = math.ceil(2.0 * math.pi * max(reach, 5.0) / image.cell)
        angles = np.arange(turns) * (2.0 * math.pi / turns) - math.pi
        standing = image.standing
        if window is not None:
            angles = angles[np.abs([wrap_angle(a - window[3]) for a in angles]) <= c.guess_turn]
            iy, ix = np.indices(standing.shape)
            x, y = (image.corner[0] + (ix + 0.5) * image.cell, image.corner[1] + (iy + 0.5) * image.cell)
            standing = np.hypot(x - window[0], y - window[1]) <= c.guess_way
        stride = 1 << (self.map.config.depth - 1)
        blocks = math.ceil(standing.shape[0] / stride) * math.ceil(standing.shape[1] / stride)
        best = np.empty((blocks * SECTORS, 4), np.int64)
        least = int(c.score_least * 255 * len(points))
        kernel.search(image.stack, standing, image.cell, points, angles, SECTORS, c.keep_ratio, least, best)
        best = best[best[:, 0] >= 0]
        best = best[np.argsort(-best[:, 0], kind="stable")][: c.candidates]
        places = [image.corner[k] + (best[:, 2 - k] + 0.5) * image.cell for k in (0, 1)]
        return np.column_stack([*places, angles[best[:, 3]]])

    def _at_heights(self, local: LocalCloud, places: F64, window: F64 | None) -> list[SE3]:
        """Return starts of registration: every place at the height where most finds its kind, and at a second that is nearly as good; the best first."""
        low, high = self.map.heights[0] + SENSOR_ABOVE[0], self.map.heights[1] + SENSOR_ABOVE[1]
        if window is not None:
            low, high = float(window[2]) - self.config.guess_way, float(window[2]) + self.config.guess_way
        step = self.map.config.height_step
        count = math.ceil((high - low) / step) + 1
        thin = slice(None, None, max(1, len(local.points) // 1500))
        starts: list[tuple[float, SE3]] = []
        for place in places:
            shares = self.map.shares_at(local.points[thin], local.kinds[thin], place, low, count)
            values = shares[:, 0] + 0.5 * shares[:, 1]
            first = int(np.argmax(values))
            others = np.where(np.abs(np.arange(count) - first) * step < 1.0, -1.0, values)
            second = int(np.argmax(others))
            for h in [first, *([second] if others[second] > 0.8 * values[first] else [])]:
                x, y, yaw = place.tolist()
                starts.append((-float(values[h]), SE3.from_rpy((x, y, low + h * step), 0.0, 0.0, yaw)))
        starts.sort(key=lambda s: s[0])
        return [pose for value, pose in starts if value <= self.config.promising * starts[0][0]]

    def _believed(self, local: LocalCloud, found: tuple[CloudMatch, ...]) -> CloudSearch:
        """With a guess one sight suffices, if one place stands out."""
        state, _ = self.state_of(found)
        state = CloudState.FOUND if state is CloudState.VERIFYING else state
        return CloudSearch(state, found, local.odom_from_local, 1)

    def _confirmed(self, local: LocalCloud, found: tuple[CloudMatch, ...], odom_from_imu: SE3) -> CloudSearch:
        """Without a guess a place must be found again from other viewpoints, each time standing out; of several that look alike none is remembered."""
        state, is_clear = self.state_of(found)
        viewpoints, known = 0, self._map_from_odom
        self._map_from_odom = None
        if state is CloudState.VERIFYING:
            is_same = known is not None and self._is_same(known @ local.odom_from_local, found[0].map_from_local)
            viewpoints = self._answer.viewpoints + 1 if is_same else 1
            self._are_clear = is_clear and (self._are_clear or not is_same)
            self._map_from_odom = found[0].map_from_local @ local.odom_from_local.inverse()
            if viewpoints >= (self.config.viewpoints if self._are_clear else self.config.viewpoints_barely):
                state = CloudState.FOUND
        self._viewpoint, self._fresh = odom_from_imu, 0
        return CloudSearch(state, found, local.odom_from_local, viewpoints)

    def state_of(self, found: tuple[CloudMatch, ...]) -> tuple[CloudState, bool]:
        """Return NOT_FOUND, AMBIGUOUS or VERIFYING, and whether the best leads clearly. In a bare hall all places explain nearly all: there it suffices
        that the best leaves much less unexplained. Of two decks that look alike the wrong one may lead because nothing was taken away there: the best must lead with lenience, too.
        """
        c = self.config
        if not found or not self._is_possible(found[0]):
            return CloudState.NOT_FOUND, False
        if any(other.lenient_quality > found[0].lenient_quality for other in found[1:]):
            return CloudState.AMBIGUOUS, False
        best, second = found[0].quality, found[1].quality if len(found) > 1 else -1.0
        if best - second >= c.margin:
            return CloudState.VERIFYING, True
        is_ahead = best - second >= c.margin_least and 1.0 - best <= c.rest_ratio * (1.0 - second)
        return (CloudState.VERIFYING if is_ahead else CloudState.AMBIGUOUS), False

    def _is_possible(self, match: CloudMatch) -> bool:
        return match.quality >= self.config.accept and match.flats >= self.config.flat_least

    def _is_same(self, a: SE3, b: SE3) -> bool:
        off, turn = apart(a, b)
        return off < self.config.same_way and turn < self.config.same_turn


def _spread(points: F64, cell: float, most: int) -> NDArray[np.float32]:
    """Return at most `most` of the points (N, 2), one per cell, evenly chosen by angle: a long wall says no more than a short one nearby."""
    cells = np.floor(points / cell).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    own = points[np.sort(first)]
    own = own[np.argsort(np.arctan2(own[:, 1], own[:, 0]), kind="stable")]
    chosen = np.unique(np.linspace(0, len(own) - 1, min(most, len(own))).round().astype(np.int64))
    return np.ascontiguousarray(own[chosen], np.float32)


def _upright(pose: SE3) -> SE3:
    """Return a pose without its roll and pitch."""
    return SE3.from_rpy(pose.translation, 0.0, 0.0, pose.to_se2().yaw)
