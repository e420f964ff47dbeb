"""Curves of a run that all reports share: errors with the largest one marked, speed over ground, coverage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.evaluation.metrics import length
from ambler.evaluation.pictures import Mark, draw_series

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
SPEED_SPAN = 1.0  # seconds over which a speed is told: longer than a step of a walking robot


def worst(stamps_ns: I64, errors: F64, begin_ns: int, what: str = "error") -> tuple[int, float, str]:
    """Return the index of the largest error (m), its time (s) after the beginning, and both in words; `what` is the word for an error."""
    k = int(np.argmax(errors))
    seconds = (int(stamps_ns[k]) - begin_ns) * 1e-9
    return k, seconds, f"largest {what} {length(float(errors[k]))} at {seconds:.1f} s"


def worst_mark(stamps_ns: I64, errors: F64, poses: F64, begin_ns: int, what: str = "error") -> Mark:
    """Return a mark for a map where the largest error was; `poses` float64 (N, 3) belong to the stamps."""
    k, _, text = worst(stamps_ns, errors, begin_ns, what)
    return Mark(float(poses[k, 0]), float(poses[k, 1]), text)


def draw_errors(path: Path, stamps_ns: I64, errors: F64, begin_ns: int, what: str = "error") -> Path:
    """Draw errors (m) over time, the largest one marked with its value and time."""
    k, seconds, text = worst(stamps_ns, errors, begin_ns, what)
    curve = {what: ((stamps_ns - begin_ns) * 1e-9, 100.0 * errors)}
    return draw_series(path, "time, s", f"{what}, cm", curve, (seconds, 100.0 * float(errors[k]), text))


def speed_over_ground(stamps_ns: I64, poses: F64, span: float = SPEED_SPAN) -> F64:
    """Return speeds float64 (N,), m/s: the way between two places half a span before and after, so that a gait does not show."""
    times = (stamps_ns - stamps_ns[0]) * 1e-9
    before, after = np.maximum(times - 0.5 * span, 0.0), np.minimum(times + 0.5 * span, times[-1])
    way = [np.interp(after, times, column) - np.interp(before, times, column) for column in poses[:, :2].T]
    return np.asarray(np.hypot(*way) / np.maximum(after - before, 1e-9))


def draw_speed(path: Path, stamps_ns: I64, poses: F64, begin_ns: int) -> Path:
    """Draw the speed over ground of poses float64 (N, 3)."""
    curve = {"speed": ((stamps_ns - begin_ns) * 1e-9, speed_over_ground(stamps_ns, poses))}
    return draw_series(path, "time, s", f"speed over ground ({SPEED_SPAN:g} s), m/s", curve)
