"""Errors of trajectories in space: absolute (ATE) and relative over stretches of the way (RPE), as KITTI and TUM define them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
STRETCHES = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # metres of way over which relative errors are taken, those that fit

ATTITUDE_M = 1.0  # of error from the start, and how many times that after the best motion, above which
ATTITUDE_TIMES = 50.0  # the reference's attitudes may be others


@dataclass(frozen=True, slots=True, eq=False)
class SpatialError:
    """`ate_*` after the best rigid motion, `start_*` with the first poses laid upon each other, metres; `errors` float64 (N,) are the distances of the
    latter at `stamps_ns`. `rpe_trans_pct` and `rpe_rot_deg_per_m` are means over all stretches; None: the way is shorter than all of them."""

    ate_rms_m: float
    ate_max_m: float
    start_rms_m: float
    start_max_m: float
    end_m: float
    height_rms_m: float
    rotation_rms_deg: float
    path_length_m: float
    rpe_trans_pct: float | None
    rpe_rot_deg_per_m: float | None
    stamps_ns: I64
    errors: F64

    def warnings(self) -> list[str]:
        """Return what makes the reference doubtful, in words: places that agree by a rigid motion, but not by the attitude at the start."""
        if self.start_rms_m <= ATTITUDE_M or self.start_rms_m <= ATTITUDE_TIMES * self.ate_rms_m:
            return []
        return [
            f"the error from the start ({self.start_rms_m:.2f} m) is far above that after the best rigid motion ({self.ate_rms_m:.3f} m): the attitudes of the reference may be others (the order of the quaternion, x y z w, or another body's)"
        ]

    def fields(self) -> dict[str, float | None]:
        """Return the numbers by name."""
        names = [n for n in self.__slots__ if n not in ("stamps_ns", "errors")]
        return {name: getattr(self, name) for name in names}


def spatial_error(
    stamps_ns: I64, poses: Sequence[SE3], truth_ns: I64, truth: Sequence[SE3], *, max_gap: float = 0.2
) -> SpatialError:
    """Compare estimated poses with true ones of the same body, interpolated at their stamps where truths lie at most `max_gap` s apart.

    Raises BadInputError when fewer than two have a truth.
    """
    pairs = [
        (k, true) for k, stamp in enumerate(stamps_ns.tolist()) if (true := truth_at(stamp, truth_ns, truth, max_gap))
    ]
    if len(pairs) < 2:
        raise BadInputError(f"only {len(pairs)} of {len(poses)} poses have a true pose at their time")
    kept = np.array([k for k, _ in pairs])
    known = [true for _, true in pairs]
    estimate = [poses[k] for k in kept]
    places = np.array([p.translation for p in known])
    world_from_map = known[0] @ estimate[0].inverse()
    begun = [world_from_map @ p for p in estimate]
    offsets = np.array([p.translation for p in begun]) - places
    errors = np.linalg.norm(offsets, axis=1)
    rotation, shift = best_motion(np.array([p.translation for p in estimate]), places)
    aligned = np.linalg.norm(np.array([p.translation for p in estimate]) @ rotation.T + shift - places, axis=1)
    turns = np.array([_angle(a.inverse() @ b) for a, b in zip(known, begun, strict=True)])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    drift, turn = relative_errors(way, known, estimate)
    return SpatialError(
        ate_rms_m=_rms(aligned),
        ate_max_m=float(aligned.max()),
        start_rms_m=_rms(errors),
        start_max_m=float(errors.max()),
        end_m=float(errors[-1]),
        height_rms_m=_rms(offsets[:, 2]),
        rotation_rms_deg=float(np.degrees(_rms(turns))),
        path_length_m=float(way[-1]),
        rpe_trans_pct=drift,
        rpe_rot_deg_per_m=turn,
        stamps_ns=stamps_ns[kept],
        errors=errors,
    )


def truth_at(stamp_ns: int, truth_ns: I64, truth: Sequence[SE3], max_gap: float) -> SE3 | None:
    """Interpolate the true pose at a stamp; None where no truths lie around it near enough."""
    after = int(np.searchsorted(truth_ns, stamp_ns))
    if after < len(truth_ns) and truth_ns[after] == stamp_ns:
        return truth[after]
    if after == 0 or after == len(truth_ns):
        return None
    before_ns, after_ns = int(truth_ns[after - 1]), int(truth_ns[after])
    if after_ns - before_ns > max_gap * 1e9:
        return None
    return truth[after - 1].interpolate(truth[after], (stamp_ns - before_ns) / (after_ns - before_ns))


def best_motion(source: F64, target: F64) -> tuple[F64, F64]:
    """Return the rotation (3, 3) and shift (3,) of pairs (N, 3) that minimize the squared distances (Umeyama 1991, scale 1)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    rotation = u @ sign @ vt
    return rotation, target.mean(axis=0) - rotation @ source.mean(axis=0)


def relative_errors(way: F64, truth: Sequence[SE3], estimate: Sequence[SE3]) -> tuple[float | None, float | None]:
    """Return the mean drift in per cent of the way, and in degrees per metre, over all stretches that begin at every tenth pose."""
    drifts, turns = [], []
    for length in STRETCHES:
        for k in range(0, len(way), 10):
            end = int(np.searchsorted(way, way[k] + length))
            if end >= len(way):
                break
            error = (truth[k].inverse() @ truth[end]).inverse() @ (estimate[k].inverse() @ estimate[end])
            drifts.append(100.0 * float(np.linalg.norm(error.translation)) / length)
            turns.append(np.degrees(_angle(error)) / length)
    return (float(np.mean(drifts)), float(np.mean(turns))) if drifts else (None, None)


def _angle(pose: SE3) -> float:
    w, x, y, z = pose.rotation
    return 2.0 * float(np.arctan2(np.sqrt(x * x + y * y + z * z), abs(w)))


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
