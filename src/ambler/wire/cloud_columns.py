"""What drivers call the columns of a PointCloud2 besides x, y, z, and in which unit they tell the time of every point.

Velodyne `time` (float32, s after the stamp), Ouster `t` and Livox `offset_time` (uint32, ns after the stamp), Hesai and RoboSense
`timestamp` (float64, s since the epoch), Livox's PointCloud2 `timestamp` (float64, ns since the epoch). Others count ms or µs: times that the
stamp explains are of its clock, in the unit in which they are near it; all others come after the stamp, in the unit in which a sweep is as long as sweeps are.
Times of another clock (a LiDAR that nobody set, or GPS time without its leap seconds, under stamps of the computer) tell how the points follow one another: the stamp is taken for that of the first.
Autoware calls its column `time_stamp`, Blickfeld `point_time_offset`, Aeva `time_offset_ns`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError

TIME = ("time", "t", "timestamp", "offset_time", "time_offset", "time_stamp", "point_time_offset", "time_offset_ns")
RING = ("ring", "line", "channel")
INTENSITY = ("intensity", "reflectivity")
EPOCH_S, EPOCH_NS = 1e8, 1e17  # from here on a time is counted since the epoch (1973), in s or ns
UNITS_NS = (1_000_000_000, 1_000_000, 1000, 1)
SWEEP_MOST = 2.0  # s; the longest sweep, and a thousand times the shortest: each number of a sweep has one unit
WHOLE_MOST = 0.5  # s; whole numbers are of this long a sweep at most, if any unit gives one: of a packet of 1.5 ms the ns are also of 1.5 s in µs
SPAN_LEAST = 5e-3  # of the last point's time after the stamp; times of another clock hardly differ
OVER_MOST = 30.0  # spacings of clouds that one may last: several LiDARs may send on one topic
FEW = 100  # so few points may be from any part of a sweep, and tell no unit


def column(packed: NDArray[np.void], names: tuple[str, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the first column of these names, zeros when there is none."""
    for name in names:
        if name in (packed.dtype.names or ()):
            return np.array(packed[name], dtype)
    return np.zeros(len(packed), dtype)


def point_times(packed: NDArray[np.void], stamp_ns: int) -> NDArray[np.float32]:
    """Return the seconds after the stamp at which every point was taken, float32 (N,); zeros when nothing tells.

    Raises BadInputError for times that in no unit are of a sweep.
    """
    name = next((name for name in TIME if name in (packed.dtype.names or ())), None)
    if name is None or len(packed) == 0:
        return np.zeros(len(packed), np.float32)
    told = packed[name]
    counted = told[np.isfinite(told) & (told != 0)]  # points that are none are often all zeros
    if len(counted) == 0:
        return np.array(told, np.float32)
    low, high = float(counted.min()), float(counted.max())
    is_whole = told.dtype.kind in "iu"
    is_coarse = not is_whole and told.dtype.itemsize < 8  # for times since the epoch
    unit_ns = None if is_coarse else _unit_of_clock(low, high, stamp_ns, is_whole=is_whole)
    if unit_ns is not None and abs(high * unit_ns - stamp_ns) > SWEEP_MOST * 1e9:
        return _after_first(told, counted, unit_ns)
    if unit_ns is not None and is_whole:
        return np.asarray((told.astype(np.int64) * unit_ns - stamp_ns) * 1e-9, np.float32)
    if unit_ns is not None:
        return np.asarray((told - stamp_ns / unit_ns) * (1e-9 * unit_ns), np.float32)
    unit_ns = _unit_of_sweep(low, high, len(counted), is_whole=is_whole)
    if unit_ns is not None:
        return np.asarray(told.astype(np.float64) * (1e-9 * unit_ns), np.float32)
    if low == high:
        return np.zeros(len(packed), np.float32)
    unit_ns = None if is_coarse else _unit_of_span(high - low, is_whole=is_whole)
    if unit_ns is not None:
        return _after_first(told, counted, unit_ns)
    raise BadInputError(
        f"the column {name!r} tells times from {low:g} to {high:g}: in s, ms, µs or ns, after the stamp of the cloud "
        f"({stamp_ns * 1e-9:.3f} s) or of its clock, no sweep is like that"
    )


def times_within(time: NDArray[np.float32], spacing: float | None) -> NDArray[np.float32]:
    """Return the times (N,) of a cloud's points in the unit that `spacing` (s between clouds) bears out, where the numbers alone had been of another:
    no cloud lasts dozens of times as long as that, and where clouds are a second apart a sweep that fills it is no flash."""
    if spacing is None or spacing <= 0.0:
        return time
    last = float(np.max(np.abs(time), initial=0.0, where=np.isfinite(time)))
    if last > OVER_MOST * spacing and 1e-3 * last <= 3.0 * spacing:
        return time * np.float32(1e-3)
    if spacing > WHOLE_MOST and 0.7 * spacing <= 1e3 * last <= min(1.1 * spacing, SWEEP_MOST):
        return time * np.float32(1e3)
    return time


def _unit_of_clock(low: float, high: float, stamp_ns: int, *, is_whole: bool) -> int | None:
    """Return the unit (ns) in which times are of the stamp's clock, None when they are not."""
    stamp = 1e-9 * stamp_ns
    near = 0.5 * stamp if stamp > EPOCH_S else SWEEP_MOST
    for unit_ns in UNITS_NS[1:] if is_whole else UNITS_NS:
        unit = 1e-9 * unit_ns
        is_sweep = (high - low) * unit <= SWEEP_MOST
        if stamp > 5.0 * SWEEP_MOST and is_sweep and abs(high * unit - stamp) < near:
            return unit_ns
    return None


def _unit_of_sweep(low: float, high: float, count: int, *, is_whole: bool) -> int | None:
    """Return the unit (ns) in which times after the stamp are those of a sweep; None: there is none."""
    largest, usual = max(abs(low), abs(high)), 1 if is_whole else UNITS_NS[0]
    is_usual = largest * usual * 1e-9 <= SWEEP_MOST
    if count < FEW:
        return usual
    if low == high:
        return usual if is_usual else None
    if high - low < SPAN_LEAST * largest:
        return None
    return _unit_of_span(largest, is_whole=is_whole) or (usual if is_usual else None)


def _unit_of_span(span: float, *, is_whole: bool) -> int | None:
    """Return the unit (ns) in which so much is as long as a sweep."""
    for most in (WHOLE_MOST, SWEEP_MOST) if is_whole else (SWEEP_MOST,):
        fits = (unit_ns for unit_ns in UNITS_NS if 1e-3 * most < span * unit_ns * 1e-9 <= most)
        if (unit_ns := next(fits, None)) is not None:
            return unit_ns
    return None


def _after_first(told: NDArray[Any], counted: NDArray[Any], unit_ns: int) -> NDArray[np.float32]:
    """Return the seconds (N,) after the first of the times that count; those that do not are no times of points."""
    wide = np.int64 if told.dtype.kind in "iu" else np.float64
    return np.asarray((told.astype(wide) - counted.min().astype(wide)) * (1e-9 * unit_ns), np.float32)
