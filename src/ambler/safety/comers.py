"""Which of the remembered points belong to somebody who came by himself, and whether he has left.

From planar scanners that look all around (`blind_memory.see_all_around`) nobody hides: when for some time nothing at all is seen around a place, he has gone. Behind
a robot that does not see backwards anybody may stand. A scanner of many rings looks over whoever crouches, so he must be seen to leave: of who stands near it sees
the trunk, which is followed from scan to scan, away from what is remembered of him. That needs a scanner that stands level and looks all around: one that is tilted sees over low
things in one heading that it meets in another, and holds what it remembers.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import looks as kernels
from ambler.safety.field_of_view import FieldOfView, Rays
from ambler.safety.visitors import NEAR, TOLERANCES, Visitors

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

GONE = 2.0  # seconds without a return near a place
# Metres and radians inside the limits where a cloud's scanner sees the same in every scan, however the robot nods, up to LEAN radians.
FIRM = (0.1, math.radians(5.0))
LEAN = FIRM[1]
SAME = 0.05  # metres by which a scan was taken from nearer to a place at most: from nearer, more of what is low is out of sight
DIRECTION = math.radians(0.5)  # of whose returns the nearest stands for all
BESIDE = 0.15  # metres between a trunk and a leg of his
STEP = 0.3  # metres that a trunk moves between two scans, and from its middle to its side
LEFT = 0.8  # metres from where he was remembered to where he is seen now: nothing of him is there any more
# Metres up to which no thin leg slips through between two beams of a planar scanner, and no trunk through those of a cloud's.
FAR = (1.5, 3.0)


class Comers:
    """Feed every scan of one scanner with `look`; then ask who `have_left`, and tell which points are remembered from now on. All places (N, 2) are in the odom frame, m."""

    def __init__(self, footprint: F64 | None = None) -> None:
        self._visitors = Visitors(footprint)
        self._lower = Visitors()  # the same with all that a cloud's scanner sees
        self._came = np.empty(0, np.bool_)
        self._near_at = np.empty(0)
        self._followed = np.empty((0, 2))  # where his trunk was last
        self._seconds = self._travel = 0.0
        self._points = self._trunks = np.empty((0, 2))
        self._is_planar = True
        self._sensor_from_odom, self._polar = SE2(), (np.empty(0), np.empty(0))

    @property
    def came(self) -> Flags:
        """Which of the remembered points are somebody's who came, (N,)."""
        return self._came

    def look(
        self,
        seconds: float,
        travel: float,
        odom_from_base: SE2,
        base_from_sensor: SE3,
        field: FieldOfView,
        rays: Rays,
        points: F64,
    ) -> None:
        """Take a planar scan of the time `seconds`, 0 where nothing may be told from it, when the outermost corner had come `travel` metres: its returns as `rays` and as `points` (N, 2)."""
        self._seconds, self._travel, self._is_planar, self._points = seconds, travel, True, points
        self._visitors.stand(seconds, travel, odom_from_base)
        azimuth, sector = rays[1], field.azimuth
        if base_from_sensor.rotate((0.0, 0.0, 1.0))[2] < 0.0:  # it hangs: in the plane its azimuths run the other way
            azimuth, sector = -azimuth, (-sector[1], -sector[0])
        odom_from_sensor, reach = odom_from_base @ base_from_sensor.to_se2(), (field.range_min, FAR[0])
        self._visitors.look(seconds, travel, odom_from_sensor, (rays[0], azimuth), sector, reach)

    def look_around(
        self,
        seconds: float,
        travel: float,
        odom_from_base: SE2,
        base_from_sensor: SE3,
        field: FieldOfView,
        points: F64,
        beyond: F64,
    ) -> None:
        """The same with a cloud: its returns (N, 3) in the level base, and some more (M, 3), whatever they met: where they lie far away, their rays passed what is nearer."""
        self._seconds, self._travel, self._is_planar = seconds, travel, False
        self._trunks, self._polar = np.empty((0, 2)), (np.empty(0), np.empty(0))
        is_level = base_from_sensor.rotate((0.0, 0.0, 1.0))[2] >= math.cos(LEAN)
        if seconds <= 0.0 or not is_level or not field.is_round:
            return
        self._visitors.stand(seconds, travel, odom_from_base)
        odom_from_sensor = odom_from_base @ base_from_sensor.to_se2()
        self._sensor_from_odom = odom_from_sensor.inverse()
        away = np.concatenate((points, beyond)) - np.asarray(base_from_sensor.translation)
        flat = np.hypot(away[:, 0], away[:, 1])
        is_told = np.arange(len(away)) < len(points)
        is_told |= flat > FAR[1]
        lowest, highest = (math.tan(field.elevation[k] + sign * FIRM[1]) for k, sign in ((0, 1.0), (1, -1.0)))
        is_firm = is_told & (flat >= field.range_min + FIRM[0])
        is_firm &= (away[:, 2] >= lowest * flat) & (away[:, 2] <= highest * flat)
        turn = SE2(0.0, 0.0, -base_from_sensor.to_se2().yaw)
        reach = (field.range_min, FAR[1])
        self._polar = polar = _nearest_by_azimuth(turn.transform(away[is_firm, :2]))
        self._visitors.look(seconds, travel, odom_from_sensor, polar, field.azimuth, reach)
        lower = _nearest_by_azimuth(turn.transform(away[is_told, :2]))
        reach = (field.range_min - TOLERANCES[1], FAR[1])  # whose rays come back from behind a place have passed it
        self._lower.look(seconds, travel, odom_from_sensor, lower, field.azimuth, reach)
        near = odom_from_sensor.transform(_from_polar(*polar)[polar[0] < FAR[1]])
        self._trunks = near[self._visitors.came(near, near[:0], seconds, travel)]

    def have_left(self, places: F64) -> Flags:
        """Return bool (N,), of the remembered points at `places`: whether they are somebody's who came, and has gone."""
        came = places[self._came]
        out = np.zeros(len(places), np.bool_)
        if len(came) == 0:
            return out
        if self._is_planar:
            near = _gaps(came, self._points) <= NEAR
            self._near_at[self._came] = np.where(near, self._seconds, self._near_at[self._came])
            out[self._came] = self._seconds - self._near_at[self._came] > GONE
            return out
        followed = _nearest(self._followed[self._came], self._trunks, STEP)
        self._followed[self._came] = followed
        has_left = np.hypot(*(followed - came).T) > LEFT
        has_left &= _gaps(came, self._trunks) > NEAR
        has_left[has_left] = self._is_looked_through(came[has_left])
        out[self._came] = has_left
        return out

    def _is_looked_through(self, places: F64) -> Flags:
        """Return bool (N,): whether there are returns in the direction of a place, and all of them behind it. Who leans on the robot nearer to a scanner than it sees leaves none."""
        everywhere = np.array(((0.0, math.pi), (0.0, math.inf)))
        out, nothing = np.zeros(len(places), np.uint8), np.empty((0, 2))
        there = self._sensor_from_odom.transform(places)
        kernels.mark_comers(
            *(
                self._polar[1],
                self._polar[0],
                nothing,
                everywhere,
                TOLERANCES,
                there,
                nothing,
                np.empty(0, np.uint8),
                out,
            )
        )
        return np.asarray(out == kernels.CAME)

    def remember(self, new: F64, is_kept: Flags, chosen: NDArray[np.int64]) -> None:
        """Take which points are remembered now: `chosen` rows of those at `new` (M, 2) and, after them, of the old ones that are `is_kept` (N,)."""
        if self._is_planar:
            came = self._visitors.came(new, self._points, self._seconds, self._travel)
        else:
            came = _gaps(new, self._trunks) <= BESIDE
            least = np.hypot(*self._sensor_from_odom.transform(new[came]).T) - SAME
            came[came] = self._lower.agree_that_came(new[came], self._seconds, self._travel, least)
        self._came = np.concatenate((came, self._came[is_kept]))[chosen]
        self._near_at = np.concatenate((np.full(len(new), self._seconds), self._near_at[is_kept]))[chosen]
        self._followed = np.concatenate((new, self._followed[is_kept]))[chosen]


def _nearest_by_azimuth(points: F64) -> tuple[F64, F64]:
    """Return range and azimuth, ascending, of the nearest of the points (N, 2), scanner's frame, in every direction in which there are any."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    count = round(2.0 * math.pi / DIRECTION)
    ranges = np.full(count, np.inf)
    np.minimum.at(ranges, np.floor((azimuth + math.pi) / DIRECTION).astype(np.int64) % count, np.hypot(*points.T))
    has_any = np.isfinite(ranges)
    middles = DIRECTION * (np.arange(count) + 0.5) - math.pi
    return ranges[has_any], middles[has_any]


def _from_polar(ranges: F64, azimuth: F64) -> F64:
    return np.asarray(ranges[:, None] * np.column_stack((np.cos(azimuth), np.sin(azimuth))))


def _apart(places: F64, others: F64) -> F64:
    return np.asarray(np.hypot(*(places[:, None] - others[None]).transpose(2, 0, 1)))


def _gaps(places: F64, others: F64) -> F64:
    """Return how far places (N, 2) are from the nearest of others (M, 2), (N,)."""
    return np.asarray(_apart(places, others).min(axis=1, initial=np.inf))


def _nearest(places: F64, others: F64, within: float) -> F64:
    """Return of each of the places (N, 2) the nearest of the others (M, 2) that lies so many metres from it at most, else itself."""
    if len(others) == 0:
        return places
    apart = _apart(places, others)
    k = apart.argmin(axis=1)
    return np.where((apart[np.arange(len(places)), k] <= within)[:, None], others[k], places)
