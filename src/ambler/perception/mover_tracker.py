"""Tracks of people and whatever else moves, from planar scans alone.

Points that move (`kernels.movers`) are grouped; each group is about where a person is. A track follows the nearest group with the gains of a
straight line fitted to its first measurements, which fade to those of an alpha-beta filter (Kalata 1984). Somebody who stops stays a
track while anything stands there that came later than the room was seen. Of a cloud only what goes on above its height band counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.movers import NOBODY, Movers
from ambler.kernels import movers as kernels
from ambler.registration.planar_scan import PlanarScan

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MoverConfig:
    """Numbers of the tracker, SI.

    reach           metres from a scanner within which movers are looked for: 2 s of a person and a robot who approach each other
    resolution      side of a cell; below half a person, above the noise of ranges
    age             seconds for which a cell may be occupied and still count as reached by something that moves: a person of 0.5 m who
                    walks at 0.7 m/s is past a place by then
    link            metres between neighbouring points of one group
    min_points      points of a group: a person at the end of the reach shows more
    size_max        metres across a group; a larger one is no person
    to_middle       metres from the mean of the visible side of a person to the middle
    gate            metres from a track's prediction within which a group may be its own
    alpha, beta     the gains that the fit fades to
    confirmed       measurements after which a track is believed, if it has moved by `way` metres and nothing stands within `vacated` metres
                    of where it began: a wall that comes into sight piece by piece leaves its first piece behind
    close           metres from a scanner within which `close_confirmed` measurements and `close_way` metres are enough: there is no time for
                    more, and walls that come into sight piece by piece lie farther off
    coast           seconds for which a track that nobody sees goes on
    speed_max       faster than this nobody walks, m/s; below `speed_min` he counts as standing
    still           seconds after which somebody who has not moved by `way` is an obstacle like others, until he does: what is no person at all
                    (a post that came into sight behind glass) would be yielded to for ever
    """

    reach: float = 5.5
    resolution: float = 0.1
    age: float = 0.7
    link: float = 0.25
    min_points: int = 3
    size_max: float = 0.9
    to_middle: float = 0.15
    gate: float = 0.5
    alpha: float = 0.5
    beta: float = 0.2
    confirmed: int = 3
    way: float = 0.3
    vacated: float = 0.15
    close: float = 1.6
    close_confirmed: int = 2
    close_way: float = 0.1
    coast: float = 0.8
    speed_max: float = 2.0
    speed_min: float = 0.3
    still: float = 10.0


class _Track:
    """One mover: position and velocity, when it was last measured, and how often."""

    def __init__(self, place: F64, now: float) -> None:
        self.place, self.velocity, self.walk = place, np.zeros(2), np.zeros(2)
        self.born, self.seen, self.at = place, now, now
        self.count = 1
        self.is_mover = False
        self.rest, self.resting_since = place, now

    def predicted(self, now: float) -> F64:
        return self.place + self.velocity * (now - self.at)

    def measure(self, place: F64, now: float, config: MoverConfig, points: F64, starts: F64) -> None:
        """Take a place; `points` (N, 2) are all that the scan hit, from `starts`."""
        self.count += 1
        k, dt = self.count, now - self.at
        alpha = max(config.alpha, 2.0 * (2 * k - 1) / (k * (k + 1)))
        beta = max(config.beta, 6.0 / (k * (k + 1)))
        rest = place - self.predicted(now)
        self.place = self.predicted(now) + alpha * rest
        if dt > 0.0:
            self.velocity = self.velocity + beta * rest / dt
        speed = math.hypot(*self.velocity)
        if speed > config.speed_max:
            self.velocity = self.velocity * (config.speed_max / speed)
        self.at = self.seen = now
        is_close = float(np.hypot(*(starts - self.place).T).min()) < config.close
        enough, way = (config.close_confirmed, config.close_way) if is_close else (config.confirmed, config.way)
        moved = math.dist(self.place, self.rest)
        if moved > config.way or (moved > way and speed > config.speed_min):
            self.rest, self.resting_since = self.place, now
        if not self.is_mover and self.count >= enough and math.dist(self.place, self.born) >= way:
            self.is_mover = not (np.hypot(*(points - self.born).T) < config.vacated).any()
        if self.is_mover and speed >= max(config.speed_min, 0.8 * math.hypot(*self.walk)):
            self.walk = self.velocity


class MoverTracker:
    """Feed every scan with where it was taken; read the movers of its instant."""

    def __init__(self, config: MoverConfig | None = None) -> None:
        self._config = c = config if config is not None else MoverConfig()
        self._size = math.ceil(2.2 * c.reach / c.resolution)
        self._grid = np.zeros((5, self._size * self._size), np.int64)
        self._grid[0] = np.iinfo(np.int64).min
        self._times = np.zeros((2, self._size * self._size))
        self._scan = 0
        self._begun_ns: int | None = None
        self._tracks: list[_Track] = []
        self.movers = NOBODY

    def update(self, scan: PlanarScan, points: F64, free_ends: F64, starts: F64, free_starts: F64) -> Movers:
        """Take a scan whose points (N, 2), free ends (M, 2) and starts of rays (N or 1, 2), (M or 1, 2) are told in the odom frame."""
        if self._begun_ns is None:
            self._begun_ns = scan.stamp_ns
        now = (scan.stamp_ns - self._begun_ns) * 1e-9
        points = np.require(points, np.float64, ["C", "W"])
        kinds = self._judged(points, free_ends, starts, free_starts, now)
        # Rays pass over what is low until the robot stands farther off; whoever walks is tall.
        if scan.falls is not None:
            kinds[np.isfinite(scan.falls.tops)] = kernels.STANDING
        places = self._groups(points, kinds, starts)
        came = points[kinds != kernels.STANDING]  # beside a wall, too: who is known may lean on it
        for track in self._tracks:
            self._follow(track, places, came, points, starts, now)
        self._tracks += [_Track(place, now) for place in places]
        self._tracks = [t for t in self._tracks if now - t.seen <= self._config.coast]
        rows = [
            np.concatenate((t.predicted(now), t.velocity, t.walk))
            for t in self._tracks
            if t.is_mover and not self._is_still(t, now)
        ]
        self.movers = Movers(scan.stamp_ns, np.array(rows).reshape(-1, 6))
        return self.movers

    def _is_still(self, track: _Track, now: float) -> bool:
        return now - track.resting_since > self._config.still

    def _judged(self, points: F64, free_ends: F64, starts: F64, free_starts: F64, now: float) -> NDArray[np.uint8]:
        self._scan += 1
        c, kinds = self._config, np.zeros(len(points), np.uint8)
        begins, ends, free_begins = (np.require(a, np.float64, ["C", "W"]) for a in (starts, free_ends, free_starts))
        kernels.judge_points(
            *(
                points,
                begins,
                ends,
                free_begins,
                now,
                self._scan,
                c.reach,
                c.resolution,
                c.age,
                self._grid,
                self._times,
                kinds,
            )
        )
        return kinds

    def _groups(self, points: F64, kinds: NDArray[np.uint8], starts: F64) -> list[F64]:
        """Return the middles of everything of a person's size that moves."""
        c = self._config
        chosen = kinds == kernels.MOVING
        points, kinds = points[chosen], kinds[chosen]
        starts = starts[chosen] if len(starts) > 1 else starts
        labels, queue = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
        count = kernels.group_points(points, kinds, kernels.MOVING, c.link, labels, queue)
        places = []
        for k in range(count):
            group = points[labels == k]
            if len(group) >= c.min_points and float(np.hypot(*np.ptp(group, axis=0))) <= c.size_max:
                places.append(self._middle(group, starts[labels == k] if len(starts) > 1 else starts))
        return places

    def _middle(self, group: F64, starts: F64) -> F64:
        mean, away = group.mean(axis=0), group.mean(axis=0) - starts.mean(axis=0)
        return np.asarray(mean + self._config.to_middle * away / max(1e-9, math.hypot(*away)))

    def _follow(self, track: _Track, places: list[F64], came: F64, points: F64, starts: F64, now: float) -> None:
        """Give a track the group that is nearest to where it should be, else whatever stands there that came later."""
        c, expected = self._config, track.predicted(now)
        if places:
            away = [math.dist(expected, place) for place in places]
            k = int(np.argmin(away))
            if away[k] <= c.gate:
                track.measure(places.pop(k), now, c, points, starts)
                return
        near = came[np.hypot(*(came - expected).T) <= 0.7 * c.gate] if track.is_mover else came[:0]
        if len(near) >= c.min_points:
            track.measure(self._middle(near, starts), now, c, points, starts)
