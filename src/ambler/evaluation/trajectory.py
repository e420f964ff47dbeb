"""Absolute trajectory error: root mean square distance of estimated and true positions at common instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.alignment import best_rigid_motion

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryError:
    """Errors in metres and radians. `ate_rms_m` after the best rigid alignment `truth_from_estimate`, `unaligned_rms_m` in the
    frames as they are; `errors` float64 (N,) are the aligned distances at `stamps_ns` int64 (N,), `offsets` those without alignment,
    `estimate` float64 (N, 3) the poses there."""

    ate_rms_m: float
    ate_max_m: float
    unaligned_rms_m: float
    yaw_rms_rad: float
    truth_from_estimate: SE2
    stamps_ns: I64
    errors: F64
    offsets: F64
    estimate: F64


def truth_at(stamps_ns: I64, truth_stamps_ns: I64, truth: F64, max_gap: float) -> tuple[NDArray[np.bool_], F64]:
    """Interpolate true poses (M, 3) at the stamps (N,); returns which stamps lie between truths at most `max_gap` s apart,
    and the poses there (N, 3)."""
    t = stamps_ns.astype(np.float64) - float(truth_stamps_ns[0])
    known = truth_stamps_ns.astype(np.float64) - float(truth_stamps_ns[0])
    after = np.clip(np.searchsorted(truth_stamps_ns, stamps_ns), 1, max(1, len(known) - 1))
    gap = (known[np.minimum(after, len(known) - 1)] - known[after - 1]) * 1e-9
    exact = np.isin(stamps_ns, truth_stamps_ns)
    inside = (stamps_ns >= truth_stamps_ns[0]) & (stamps_ns <= truth_stamps_ns[-1])
    yaw = np.unwrap(truth[:, 2])
    poses = np.stack([np.interp(t, known, c) for c in (truth[:, 0], truth[:, 1], yaw)], axis=1)
    return np.asarray(inside & (exact | (gap <= max_gap))), poses


def trajectory_error(
    stamps_ns: I64, estimate: F64, truth_stamps_ns: I64, truth: F64, *, max_gap: float = 0.1
) -> TrajectoryError:
    """Compare estimated poses (N, 3) of (x, y, yaw) with true ones (M, 3), both with ascending stamps.

    Truth is interpolated at the estimate's stamps; stamps without truth near enough are left out. Raises BadInputError when
    fewer than two remain.
    """
    if len(truth_stamps_ns) == 0:
        raise BadInputError("there is no true trajectory to compare with")
    is_known, poses = truth_at(stamps_ns, truth_stamps_ns, truth, max_gap)
    if int(is_known.sum()) < 2:
        raise BadInputError(f"only {int(is_known.sum())} of {len(stamps_ns)} poses have a true pose at their time")
    estimate, poses = estimate[is_known], poses[is_known]
    truth_from_estimate = best_rigid_motion(estimate[:, :2], poses[:, :2])
    aligned = truth_from_estimate.transform(estimate[:, :2])
    errors = np.hypot(*(aligned - poses[:, :2]).T)
    unaligned = np.hypot(*(estimate[:, :2] - poses[:, :2]).T)
    turn = estimate[:, 2] + truth_from_estimate.yaw - poses[:, 2]
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    return TrajectoryError(
        ate_rms_m=_rms(errors),
        ate_max_m=float(errors.max()),
        unaligned_rms_m=_rms(unaligned),
        yaw_rms_rad=_rms(turn),
        truth_from_estimate=truth_from_estimate,
        stamps_ns=stamps_ns[is_known],
        errors=errors,
        offsets=unaligned,
        estimate=estimate,
    )


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))
