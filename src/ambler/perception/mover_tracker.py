"""Tracks of people and whatever else moves, from planar scans alone.

Points that move (`kernels.movers`) are grouped; each group is about where a person is. A track follows the nearest group with the gains of a
straight line fitted to its first measurements, which fade to those of an alpha-beta filter (Kalata 1984). Somebody who stops stays a
track while anything stands there that came later than the room was seen, and whoever is found standing so is taken for somebody who may
set out. Of a cloud only what goes on above its height band counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.movers import NOBODY, Movers
from ambler.core.se2 import SE2
from ambler.kernels import movers as kernels
from ambler.perception.mover_track import NOTHING, MoverConfig, MoverTrack
from ambler.registration.planar_scan import PlanarScan, RayFalls

F64 = NDArray[np.float64]
SETTLING = 3  # times that everybody's points are asked for


class MoverTracker:
    """Feed every scan with where it was taken; read the movers of its instant."""

    def __init__(self, config: MoverConfig | None = None) -> None:
        self._config = c = config if config is not None else MoverConfig()
        self._size = 1 << math.ceil(math.log2(2.2 * c.reach / c.resolution))
        self._grid = np.zeros((5, self._size * self._size), np.int64)
        self._grid[0] = np.iinfo(np.int64).min
        self._times = np.zeros((3, self._size * self._size))
        self._scan = 0
        self._begun_ns: int | None = None
        self._forgotten = -math.inf
        self._tracks: list[MoverTrack] = []
        self._hidden = NOTHING
        self._map_from_odom = SE2()
        self.movers = NOBODY

    def update(
        self,
        scan: PlanarScan,
        points: F64,
        free_ends: F64,
        starts: F64,
        free_starts: F64,
        silent: F64 = NOTHING,
        map_from_odom: SE2 | None = None,
    ) -> Movers:
        """Take a scan whose points (N, 2), free ends (M, 2), starts of rays (N or 1, 2), (M or 1, 2) and places (K, 2) where something is nearer than
        the scanner sees are told in the odom frame, and where that frame lies in the map, if anybody knows."""
        if self._begun_ns is None:
            self._begun_ns = scan.stamp_ns
        now = (scan.stamp_ns - self._begun_ns) * 1e-9
        if map_from_odom is not None:
            self._correct(map_from_odom, starts.mean(axis=0) if len(starts) > 0 else np.zeros(2), now)
        told = (points, free_ends, starts, free_starts, silent)
        points, free_ends, starts, free_starts, silent = (self._map_from_odom.transform(p) for p in told)
        points = np.require(points, np.float64, ["C", "W"])
        kinds, alone = self._judged(points, free_ends, starts, free_starts, now)
        if scan.falls is not None:
            kinds[self._is_low(points, starts, scan.falls)] = kernels.STANDING
        for track in self._tracks:
            if track.is_mover:
                self._follow_in_unknown_room(track, points, kinds, alone, now)
                self._follow_out_of_sight(track, points, kinds, starts, now)
        places = self._groups(points, kinds, starts)
        is_here = kinds != kernels.STANDING  # beside a wall, too: who is known may lean on it
        came = _Came(
            points[is_here],
            _of_rays(starts, is_here),
            kinds[is_here] != kernels.MOVING,
            alone[is_here] == kernels.ALONE,
        )
        walkers = np.array([t.predicted(now) for t in self._tracks if t.is_mover]).reshape(-1, 2)
        for track, place, is_his in zip(self._tracks, *self._owned(came, now), strict=True):
            self._follow(track, place, places, walkers, came.some(is_his), points, starts, now)
        self._tracks += [MoverTrack(place, now) for place in places]
        self._tracks = self._one_each([t for t in self._tracks if now - t.seen <= self._config.coast or self._hides(t)])
        came_alone = (kinds == kernels.CAME) & (alone == kernels.ALONE)
        for place in self._standing(points, came_alone, points[~came_alone & (kinds != kernels.MOVING)], starts):
            self._note_standing(place, now)
        self._hidden = np.array([p for p in silent if self._is_hidden(p, now)]).reshape(-1, 2)
        for place in self._hidden:
            self._note_hidden(place, now)
        told_of = [t for t in self._tracks if t.is_mover and not self._is_still(t, now)]
        rows = [np.concatenate((t.predicted(now), t.pace(now), t.walk)) for t in told_of]
        untold = [p for p in self._hidden if all(math.dist(p, row[:2]) > 1e-9 for row in rows)]
        rows += [np.concatenate((place, np.zeros(4))) for place in untold]
        rests = np.array([now - t.resting_since for t in told_of] + [0.0] * len(untold))
        states = _told_in(np.array(rows).reshape(-1, 6), self._map_from_odom.inverse())
        self.movers = Movers(scan.stamp_ns, states, rests)
        return self.movers

    def _correct(self, map_from_odom: SE2, scanner: F64, now: float) -> None:
        """Remember the room in the map's frame: odometry that drifts by a tenth of a radian in some minutes would bring walls back to where the
        room was seen free. People were seen from where the robot thought to be, and move with a correction; one that moves what the scanner at
        `scanner` (2,) of the odom frame sees by more than a cell makes the room unknown."""
        new_from_old = map_from_odom @ self._map_from_odom.inverse()
        before = self._map_from_odom.transform(scanner[None, :])
        shift = math.dist(new_from_old.transform(before)[0], before[0])
        self._map_from_odom = map_from_odom
        if shift + self._config.reach * abs(new_from_old.yaw) > self._config.resolution:
            self._grid[0] = np.iinfo(np.int64).min
            self._forgotten = now
        for track in self._tracks:
            track.move(new_from_old)
        self._hidden = new_from_old.transform(self._hidden)

    def _is_hidden(self, place: F64, now: float) -> bool:
        """Say whether somebody stands where the scanner fell silent: one who was there already, or whoever was tracked near it."""
        vouching = [t for t in self._tracks if t.is_mover and now - t.measured <= self._config.hides]
        known = [*self._hidden, *(t.predicted(now) for t in vouching)]
        return any(math.dist(place, other) < self._config.hidden for other in known)

    def _is_low(self, points: F64, starts: F64, falls: RayFalls) -> NDArray[np.bool_]:
        """Say of every point whether it belongs to something low, over which rays pass until the robot stands farther off; whoever walks is tall.
        Of who stands close no ray sees the head: what goes up to the scanner there may be he."""
        is_close = np.hypot(*(points - starts).T) < self._config.headless
        return np.asarray(np.isfinite(falls.tops) & ~(is_close & (falls.tops > falls.height - self._config.headroom)))

    def _is_still(self, track: MoverTrack, now: float) -> bool:
        c = self._config
        return now - track.resting_since > (c.still_walker if track.has_walked else c.still)

    def _judged(
        self, points: F64, free_ends: F64, starts: F64, free_starts: F64, now: float
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return of every point what it is, and whether nothing ever stood there (`kernels.movers.judge_points`)."""
        self._scan += 1
        c, kinds, alone = self._config, np.zeros(len(points), np.uint8), np.zeros(len(points), np.uint8)
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
                alone,
            )
        )
        return kinds, alone

    def _groups(self, points: F64, kinds: NDArray[np.uint8], starts: F64) -> list[F64]:
        """Return the middles of everything of a person's size that moves."""
        c = self._config
        chosen = kinds == kernels.MOVING
        points, kinds = points[chosen], kinds[chosen]
        starts = _of_rays(starts, chosen)
        labels, queue = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
        count = kernels.group_points(points, kinds, kernels.MOVING, c.link, labels, queue)
        places = []
        for k in range(count):
            for part in self._people_of(np.flatnonzero(labels == k), points):
                places.append(self._middle(points[part], _of_rays(starts, part)))
        return places

    def _people_of(self, rows: NDArray[np.int64], points: F64) -> list[NDArray[np.int64]]:
        """Return which rows of a group belong to whom: one person, two who stand or walk side by side, or nobody."""
        c, group = self._config, points[rows]
        size = float(np.hypot(*np.ptp(group, axis=0)))
        if len(group) < c.min_points or size > c.pair_size_max:
            return []
        if size <= c.size_max:
            return [rows]
        along = (group - group.mean(axis=0)) @ np.linalg.eigh(np.cov(group.T))[1][:, 1]
        is_first = along < 0.5 * (along.min() + along.max())
        return [part for part in (rows[is_first], rows[~is_first]) if len(part) >= c.min_points]

    def _standing(self, points: F64, came: NDArray[np.bool_], room: F64, starts: F64) -> list[F64]:
        """Return the middles of everything of a person's size that came to where nothing had stood, and stands there apart from the `room` (K, 2):
        ends of walls come into sight piece by piece."""
        c = self._config
        if np.count_nonzero(came) < c.min_points:
            return []
        starts, points = _of_rays(starts, came), points[came]
        labels, queue = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
        count = kernels.group_points(points, np.zeros(len(points), np.uint8), 0, c.link, labels, queue)
        places = []
        for k in range(count):
            for part in self._people_of(np.flatnonzero(labels == k), points):
                group = points[part]
                place = self._middle(group, _of_rays(starts, part))
                if self._was_seen(place) and self._is_person(group) and self._is_apart(group, room):
                    places.append(place)
        return places

    def _is_apart(self, group: F64, others: F64) -> bool:
        gaps = np.hypot(*(group[:, None, :] - others[None, :, :]).transpose(2, 0, 1))
        return bool(gaps.min(initial=np.inf) > self._config.link)

    def _was_seen(self, place: F64) -> bool:
        """Say whether anything has told of the cell of a place: who came stands where rays had passed, and no ray passes through a desk whose
        sides were grazed before they were met."""
        ix, iy = (int(i) for i in np.floor(place / self._config.resolution))
        k = iy % self._size * self._size + ix % self._size
        return bool(
            self._grid[0, k] == iy * 1000003 + ix and self._grid[1, k] != kernels.UNKNOWN
        )  # `kernels.movers._cell`

    def _note_standing(self, place: F64, now: float) -> None:
        """Take a place where somebody stands: his own track's, or that of one who has not been known."""
        near = [t for t in self._tracks if math.dist(place, t.predicted(now)) <= 0.8 * self._config.gate]
        for track in near:
            track.stands = True
        if not near:
            self._tracks.append(MoverTrack(place, now, stands=True))

    def _note_hidden(self, place: F64, now: float) -> None:
        """Follow whoever stands where the scanner fell silent, so that he is known still when he comes into sight."""
        near = [t for t in self._tracks if t.is_mover and math.dist(place, t.predicted(now)) <= self._config.gate]
        if not near:
            near = [MoverTrack(place, now)]
            near[0].measured = -math.inf
            self._tracks += near
        elif any(t.seen == now for t in near):
            return
        min(near, key=lambda t: math.dist(place, t.predicted(now))).hide(place, now, self._config)

    def _one_each(self, tracks: list[MoverTrack]) -> list[MoverTrack]:
        """Leave out every track that has come to be where one stands that has been measured more often: two of one person."""
        kept: list[MoverTrack] = []
        for track in sorted(tracks, key=lambda t: (not t.is_mover, -t.count)):
            if all(math.dist(track.place, other.place) > self._config.twin for other in kept):
                kept.append(track)
        return kept

    def _middle(self, group: F64, starts: F64) -> F64:
        """Return the middle of whom points (N, 2), seen from `starts` (N or 1, 2), lie on: behind each, as its own ray goes. Each counts as much as
        the piece of him that its beam covers: a scanner beside him meets the little that it sees with more beams than one that sees more from afar."""
        away = group - starts
        ranges = np.maximum(np.hypot(*away.T), 1e-9)
        behind = group + self._config.to_middle * away / ranges[:, None]
        return np.asarray(ranges @ behind / ranges.sum())

    def _owned(self, came: _Came, now: float) -> tuple[F64, list[NDArray[np.bool_]]]:
        """Return where everybody who is followed should be (K, 2), and which points are whose: two who stand side by side keep their own. Where there are several, a place that
        is expected wrong (he stopped, and was expected to go on) moves to the middle of those points around it that are nearer to it than to all
        others, and is asked again (Lloyd 1982): else it takes the other one's points, and then his place."""
        c, places = self._config, np.array([t.predicted(now) for t in self._tracks]).reshape(-1, 2)
        owned = [np.ones(len(came.points), np.bool_) for _ in self._tracks]
        rows = [k for k, t in enumerate(self._tracks) if t.is_mover or t.stands]
        if len(rows) < 2 or len(came.points) == 0:
            return places, owned
        for _ in range(SETTLING):
            away = np.hypot(*(came.points[None, :, :] - places[rows][:, None, :]).transpose(2, 0, 1))
            for k, is_nearest, to in zip(rows, away <= away.min(axis=0), away, strict=True):
                owned[k] = is_nearest
                his = is_nearest & came.is_new & (to <= 0.7 * c.gate)
                if np.count_nonzero(his) >= c.min_points:
                    places[k] = self._middle(came.points[his], _of_rays(came.starts, his))
        return places, owned

    def _follow(
        self,
        track: MoverTrack,
        expected: F64,
        places: list[F64],
        walkers: F64,
        came: _Came,
        points: F64,
        starts: F64,
        now: float,
    ) -> None:
        """Give a track what stands where he stood, else the group that is nearest to where he should be, and to nobody else of the `walkers` (K, 2), else
        whatever is there (`expected`), or where he was last, that came later than the room was seen; where nothing ever stood, if anything is: a wall
        beside which he passed is looked through by rays that graze it, and is not he, nor is who has stood beside him since before anybody looked."""
        c, predicted = self._config, track.predicted(now)
        may_stand = track.is_mover or track.stands
        near = came.near(expected, 0.7 * c.gate) if may_stand else np.zeros(len(came.points), np.bool_)
        away = [self._away(track, predicted, place, walkers) for place in places]
        nearest = min(away, default=math.inf)
        if may_stand and np.count_nonzero(near) < c.min_points and nearest > c.gate:
            near = came.near(track.place, 0.7 * c.gate)
            if np.count_nonzero(near & came.is_new) >= c.min_points:
                track.halt(now)
        is_new = near & came.is_new
        his = is_new if np.count_nonzero(is_new) >= c.min_points else near
        has_walked_off = 2 * np.count_nonzero(his & came.is_old) <= np.count_nonzero(his)
        if nearest <= c.gate and (has_walked_off or not near.any()):
            track.surface = NOTHING
            track.measure(places.pop(away.index(nearest)), now, c, points, starts)
            return
        count = np.count_nonzero(near)
        if count >= c.min_points and np.count_nonzero(is_new) >= c.new_share * count:
            if math.hypot(*track.velocity) < c.speed_min:
                track.surface = came.points[near]
            track.measure(self._middle(came.points[his], _of_rays(came.starts, his)), now, c, points, starts)

    def _away(self, track: MoverTrack, expected: F64, place: F64, walkers: F64) -> float:
        """Return how far a group's `place` is from where a track should be; inf if it is nearer to another one of the `walkers` (K, 2)."""
        away = math.dist(expected, place)
        is_anothers = track.is_mover and bool((np.hypot(*(walkers - place).T) < away - 1e-9).any())
        return math.inf if is_anothers else away

    def _follow_in_unknown_room(
        self, track: MoverTrack, points: F64, kinds: NDArray[np.uint8], alone: NDArray[np.uint8], now: float
    ) -> None:
        """Count as moving what is where somebody should be who is known, after a correction made the room unknown, and what comes into sight there
        in the next moments: nothing else tells him from a wall at which he stands. Changes `kinds` and `alone` (N,)."""
        c, since = self._config, now - self._forgotten
        if since > c.unknown:
            return
        near = np.flatnonzero(np.hypot(*(points - track.predicted(now)).T) <= 0.7 * c.gate)
        fresh = np.zeros(len(near), np.uint8)
        after = -math.inf if since == 0.0 else self._forgotten
        kernels.came_into_sight(points[near], after, c.resolution, self._grid, self._times, fresh)
        his = near[fresh != 0]
        if len(his) >= c.min_points:
            kinds[his], alone[his] = kernels.MOVING, kernels.ALONE
            kernels.make_free_before(points[his], c.resolution, self._grid, self._times)

    def _follow_out_of_sight(
        self, track: MoverTrack, points: F64, kinds: NDArray[np.uint8], starts: F64, now: float
    ) -> None:
        """Count as moving what comes into sight where somebody should be who walks, as large as a person and apart from all else: he walked to
        where no ray had been for long, and is no part of the room. Changes `kinds` (N,)."""
        c, expected = self._config, track.predicted(now)
        near = np.flatnonzero(np.hypot(*(points - expected).T) <= c.gate + c.pair_size_max)
        around, fresh = points[near], np.zeros(len(near), np.uint8)
        kernels.came_into_sight(around, now - c.age, c.resolution, self._grid, self._times, fresh)
        if not fresh.any():
            return
        labels, queue = np.empty(len(near), np.int32), np.empty(len(near), np.int32)
        count = kernels.group_points(around, np.zeros_like(fresh), 0, c.link, labels, queue)
        for chosen in (np.flatnonzero(labels == k) for k in range(count)):
            group, is_new = around[chosen], (fresh[chosen] != 0) | (kinds[near[chosen]] != kernels.STANDING)
            is_person = len(group) >= c.min_points and is_new.all() and self._is_person(group)
            if is_person and math.dist(self._middle(group, _of_rays(starts, near[chosen])), expected) <= c.gate:
                kinds[near[chosen]] = kernels.MOVING
                kernels.make_free_before(group, c.resolution, self._grid, self._times)

    def _is_person(self, group: F64) -> bool:
        """Say whether points (N, 2) are as wide as a person, and bent as one's side is."""
        c, size = self._config, float(np.hypot(*np.ptp(group, axis=0)))
        if not c.stand_size <= size <= c.size_max:
            return False
        return math.sqrt(max(0.0, float(np.linalg.eigvalsh(np.cov(group.T))[0]))) >= c.stand_bulge

    def _hides(self, track: MoverTrack) -> bool:
        """Whether somebody who was seen to walk, and then to stand, may stand there still: no ray has passed where he was hit."""
        return bool(track.walk.any()) and 2 * kernels.count_occupied(
            track.surface, self._config.resolution, self._grid
        ) > len(track.surface)


@dataclass(frozen=True, slots=True, eq=False)
class _Came:
    """What is here and stood not here from the first look on: points (N, 2), where their rays begin (N or 1, 2), which of them have been where they
    are for a while, and which lie where nothing has ever stood."""

    points: F64
    starts: F64
    is_old: NDArray[np.bool_]
    is_new: NDArray[np.bool_]

    def some(self, chosen: NDArray[np.bool_]) -> _Came:
        return _Came(self.points[chosen], _of_rays(self.starts, chosen), self.is_old[chosen], self.is_new[chosen])

    def near(self, place: F64, within: float) -> NDArray[np.bool_]:
        return np.asarray(np.hypot(*(self.points - place).T) <= within)


def _of_rays(starts: F64, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> F64:
    """Return where chosen rays begin, of `starts` (N, 2), or (1, 2) for all of them."""
    return starts[chosen] if len(starts) > 1 else starts


def _told_in(states: F64, new_from_old: SE2) -> F64:
    """Return states (K, 6) of movers told in another frame."""
    turn = SE2(0.0, 0.0, new_from_old.yaw)
    parts = (new_from_old.transform(states[:, :2]), turn.transform(states[:, 2:4]), turn.transform(states[:, 4:6]))
    return np.hstack(parts)
