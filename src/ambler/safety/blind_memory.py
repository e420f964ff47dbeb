"""Points that a scanner saw and cannot see any more: too near for it, below or above its rays, beside its sector.

A scanner says nothing about its blind zone, and nothing is not free. So the gate keeps what was last seen there, carried along by
odometry, until the scanner can see the place again, looks through it, who came by himself has gone, or odometry has drifted too far to tell. Means of many
points are kept, not the points: their extremes would pile up scan by scan and grow every wall by the noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3
from ambler.kernels import blind as kernels
from ambler.safety.comers import Comers
from ambler.safety.field_of_view import BIN, CUT, FieldOfView, Rays

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

IsFloor = Callable[[F64], Flags]
"""Says of points (N, 3), level base frame, which belong to the floor."""

COLUMN = 0.04  # metres; the side of a column of floor, of which one mean point is remembered
MIN_POINTS = 3  # points of one scan that a column needs: fewer may be noise
THROUGH = 0.1  # metres that every return of a bin must lie behind a remembered point to prove it gone
TO_AND_FRO = 0.1  # of what the outermost corner moves while the robot turns: how much of that counts as way even when it turns back
SLACK = (0.1, 0.0)  # metres and radians inside the limits where a scanner is not yet sure to see
SOON = (
    0.3,
    math.radians(5.0),
)  # metres and radians inside the limits from where a point may leave them before the next scan


class BlindMemory:
    """One scanner's memory. A point is forgotten after `max_travel` metres of way, and of the outermost corner at `radius` where the robot has turned on since: who turns to and fro looks again where he
    looked before, and odometry with him. `footprint` (M, 2): see `comers.Comers`."""

    def __init__(self, radius: float, max_travel: float, footprint: F64 | None = None) -> None:
        self._radius = radius
        self._max_travel = max_travel
        self._means_odom = np.empty((0, 3))
        self._counts = np.empty(0)
        self._seen_at = np.empty((0, 2))  # `_way` and `_turned` of then
        self._comers = Comers(footprint)
        self._travel = self._way = self._turned = 0.0
        self._odom_from_base: SE2 | None = None

    def update(
        self,
        points_base: F64,
        odom_from_base: SE2,
        base_from_sensor: SE3,
        field: FieldOfView,
        others: Sequence[tuple[SE3, FieldOfView]] = (),
        seconds: float = 0.0,
        height: float = 0.0,
        is_floor: IsFloor | None = None,
        beyond: F64 | None = None,
    ) -> F64:
        """Take a scan's points (N, 3) in the level base frame of its stamp; return float64 (M, 3) in the same frame: the means of
        columns that neither the scanner nor any of the `others` (mount, field of view) can see now and nothing has disproved. `seconds` is the
        time of the scan, from any beginning; 0: nobody is told from what the robot drove up to. `height` (m) that of the base in the odom frame, which changes on slopes. `is_floor` says of points (N, 3) in the
        base frame whether they belong to the floor, as far as that is known now: from afar a slope may have looked like an obstacle. `beyond` (K, 3): some more
        returns of a cloud, base frame, whatever they met, which show that rays passed what is nearer."""
        self._advance(odom_from_base)
        sensor_from_base = base_from_sensor.inverse()
        rays = _rays(sensor_from_base, points_base)
        is_central = field.shrunk(*SOON).contains(rays)
        is_fading = ~is_central
        is_fading[is_fading] = ~_is_seen(points_base[is_fading], others)
        points_odom = _moved(odom_from_base, points_base, height)
        told = (seconds, self._travel, odom_from_base, base_from_sensor, field)
        if field.is_planar:
            self._comers.look(*told, rays, points_odom[:, :2])
        else:
            self._comers.look_around(*told, points_base, np.empty((0, 3)) if beyond is None else beyond)
        if len(self._means_odom) == 0 and not is_fading.any():
            return np.empty((0, 3))
        kept, seen_at = _moved(odom_from_base.inverse(), self._means_odom, -height), self._seen_at
        kept_rays = _rays(sensor_from_base, kept)
        sure = field.shrunk(*SLACK)
        looks_there = replace(field, range_min=0.0).contains(
            kept_rays
        )  # beside the sector nothing can be looked through
        is_hidden = ~sure.contains(kept_rays)
        is_fading_still = _share_columns(self._means_odom, points_odom, is_fading)
        here = np.array([self._way, self._turned])
        is_kept = (is_hidden | is_fading_still) & ~_is_seen(kept, others)
        is_kept &= ~(looks_there & _looked_through(kept_rays, rays))
        is_kept &= ~_share_columns(self._means_odom, points_odom, is_central)  # at the rim, few may be left of a thing
        way, turned = (here - seen_at).T
        is_kept &= way + self._radius * np.abs(turned) < self._max_travel
        is_kept &= ~self._comers.have_left(self._means_odom[:, :2])
        if is_floor is not None:
            is_kept &= ~is_floor(kept)
        seen_at = np.where(is_fading_still[:, None], here, seen_at)
        kept, seen_at = kept[is_kept], seen_at[is_kept]
        fading, counts = _column_means(points_odom, rays[0], is_fading, field.range_min + CUT)
        together = np.concatenate((fading, self._means_odom[is_kept]))
        # While the rim passes over a thing, its near side goes first: the mean of what is left of a column replaces none of more points.
        counts = np.concatenate((counts, self._counts[is_kept]))
        fullest = np.argsort(-counts, kind="stable")
        chosen = fullest[_first_of_columns(together[fullest])]
        self._means_odom, self._counts = together[chosen], counts[chosen]
        self._seen_at = np.concatenate((np.tile(here, (len(fading), 1)), seen_at))[chosen]
        self._comers.remember(fading[:, :2], is_kept, chosen)
        return kept[is_hidden[is_kept]]

    def _advance(self, odom_from_base: SE2) -> None:
        last, self._odom_from_base = self._odom_from_base, odom_from_base
        if last is not None:
            turn = wrap_angle(odom_from_base.yaw - last.yaw)
            moved, swung = last.distance_to(odom_from_base), abs(turn) * self._radius
            self._travel += moved + swung
            self._way += moved + TO_AND_FRO * swung
            self._turned += turn


def see_all_around(rim: F64, scanners: Sequence[tuple[SE3, FieldOfView]]) -> bool:
    """Whether planar scanners (mount, field of view) together look at every point of a rim (N, 2) around the robot, base frame. Then what they
    cannot see is narrower than the rim, and nobody is hidden there whole; of a cloud's scanner this is never known, because he may crouch."""
    is_seen = np.zeros(len(rim), np.bool_)
    for base_from_sensor, field in scanners:
        if not field.is_planar:
            return False
        level = np.column_stack((rim, np.full(len(rim), base_from_sensor.translation[2])))
        is_seen |= field.contains(_rays(base_from_sensor.inverse(), level))
    return bool(is_seen.all())


def _moved(pose: SE2, points: F64, height: float) -> F64:
    """Move points (N, 3) by a planar pose, and up."""
    return np.column_stack((pose.transform(points[:, :2]), points[:, 2] + height))


def _rays(sensor_from_base: SE3, points_base: F64) -> Rays:
    n = len(points_base)
    out = (np.empty(n), np.empty(n), np.empty(n))
    kernels.rays_to(np.ascontiguousarray(sensor_from_base.matrix()[:3]), np.ascontiguousarray(points_base), *out)
    return out


def _is_seen(points_base: F64, scanners: Sequence[tuple[SE3, FieldOfView]]) -> Flags:
    """Return bool (N,): whether any scanner looks there, and not just with its rim, which may be gone at its next scan."""
    is_seen = np.zeros(len(points_base), np.bool_)
    for base_from_sensor, field in scanners:
        is_seen |= field.shrunk(*SOON).contains(_rays(base_from_sensor.inverse(), points_base))
    return is_seen


def _looked_through(kept: Rays, seen: Rays) -> Flags:
    """Return bool (N,): whether there are returns in the direction of a kept point and on both sides of it, and all of them lie behind it. What it is the
    mean of may stand anywhere in its column."""
    out = np.empty(len(kept[0]), np.bool_)
    kernels.look_through(kept, seen, BIN, THROUGH, COLUMN, out)
    return out


def _share_columns(places: F64, points: F64, is_wanted: Flags) -> Flags:
    """Return bool (N,): whether a place (N, 3) has one of the wanted points (M, 3) in its column."""
    out = np.empty(len(places), np.bool_)
    kernels.are_in_columns(places, points, is_wanted, COLUMN, out)
    return out


def _column_means(points: F64, ranges: F64, is_wanted: Flags, least: float) -> tuple[F64, F64]:
    """Return the mean point of every column that holds enough of the wanted points and none nearer to the scanner than `least`, float64 (M, 3), and
    of how many points it is, (M,): where the blind zone cuts the noise off, a mean lies too far out."""
    out = np.empty((len(points), 4))
    out = out[: kernels.column_means(points, ranges, is_wanted, COLUMN, MIN_POINTS, least, out)]
    return out[:, :3], out[:, 3]


def _first_of_columns(points: F64) -> NDArray[np.int64]:
    out = np.empty(len(points), np.int64)
    return out[: kernels.first_of_columns(points, COLUMN, out)]
