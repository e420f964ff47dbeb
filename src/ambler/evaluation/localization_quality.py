"""How good a localization was: true errors, consistency (NEES) and the variances that it told, all from CSV files of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.trajectory import truth_at
from ambler.wire.csv_files import read_columns

F64 = NDArray[np.float64]

AXES = ("x", "y", "yaw")
_PLANE = (0, 1, 5)


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationErrors:
    """Per estimate: `errors` float64 (N, 3) of (x, y, yaw) along the map's axes, `variances` (N, 3) as told, and `nees` (N,), the squared
    Mahalanobis distance per dimension: 1 in the mean when the covariance is honest, more when it promises too much."""

    stamps_ns: F64
    errors: F64
    variances: F64
    nees: F64

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns as plain lists."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}

    @classmethod
    def from_dict(cls, columns: Mapping[str, list[Any]]) -> LocalizationErrors:
        """Build from what `to_dict` gave."""
        return cls(**{name: np.array(values, float) for name, values in columns.items()})

    @property
    def rms(self) -> F64:
        """Root mean squares (3,) of the errors, metres and radians."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)))

    @classmethod
    def joined(cls, parts: Sequence[LocalizationErrors]) -> LocalizationErrors:
        """Join several drives."""
        return cls(
            *(np.concatenate([getattr(p, f) for p in parts]) for f in ("stamps_ns", "errors", "variances", "nees"))
        )


def localization_errors(
    estimates: Path, truth: Path, map_from_truth: SE2 | None = None, settle: float = 1.0
) -> LocalizationErrors:
    """Compare the CSV of `/localized_pose` with that of the true pose, which is told in a frame that lies at `map_from_truth`.

    The first `settle` seconds, in which a set pose becomes a known one, do not count. Raises BadInputError when nothing is left.
    """
    true = read_columns(truth)
    frame = (map_from_truth or SE2()).as_array()
    c, s = np.cos(frame[2]), np.sin(frame[2])
    x, y, yaw = _planar(true).T
    true_poses = np.column_stack([frame[0] + c * x - s * y, frame[1] + s * x + c * y, yaw + frame[2]])
    return errors_of(estimates, true["stamp_ns"].astype(np.int64), true_poses, settle)


def errors_of(estimates: Path, true_stamps_ns: NDArray[np.int64], true_poses: F64, settle: float) -> LocalizationErrors:
    """Compare the CSV of `/localized_pose` with true poses (M, 3) in the map; without the first `settle` seconds. Raises BadInputError when
    nothing is left."""
    told = read_columns(estimates)
    stamps = told["stamp_ns"]
    is_known, expected = truth_at(stamps.astype(np.int64), true_stamps_ns, true_poses, max_gap=0.1)
    used = is_known & (stamps >= stamps[0] + settle * 1e9)
    if not used.any():
        raise BadInputError(f"{estimates} has no pose whose truth is known")
    errors = (_planar(told) - expected)[used]
    errors[:, 2] = np.arctan2(np.sin(errors[:, 2]), np.cos(errors[:, 2]))
    covariance = np.stack(
        [np.stack([told[f"pose_covariance.{6 * a + b}"][used] for b in _PLANE], axis=1) for a in _PLANE], axis=1
    )
    nees = np.einsum("na,nab,nb->n", errors, np.linalg.inv(covariance), errors) / 3.0
    return LocalizationErrors(stamps[used], errors, np.diagonal(covariance, axis1=1, axis2=2).copy(), nees)


def draw_boxes(path: Path, title: str, groups: Mapping[str, LocalizationErrors]) -> Path:
    """Draw box plots of the told variances and of the true errors in x, y and yaw, one box per named group, into a PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.4), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3)
    names = list(groups)
    for k, axis in enumerate(AXES):
        unit, factor = ("rad", 1.0) if axis == "yaw" else ("m", 1.0)
        boxes = {
            0: ([np.maximum(groups[n].variances[:, k], 1e-12) for n in names], f"variance of {axis}, {unit}²"),
            1: ([factor * groups[n].errors[:, k] for n in names], f"true error of {axis}, {unit}"),
        }
        for row, (values, label) in boxes.items():
            ax = axes[row][k]
            ax.boxplot(values, showfliers=False, whis=(2.5, 97.5))
            ax.set_xticks(range(1, len(names) + 1), names, rotation=20, ha="right", fontsize=8)
            ax.set_title(label, fontsize=9)
            ax.grid(axis="y", color="#e5e7eb")
            if row == 0:
                ax.set_yscale("log")
    figure.suptitle(title)
    figure.savefig(path)
    return path


def _planar(columns: Mapping[str, F64]) -> F64:
    """Poses (N, 3) of the columns of an Odometry."""
    w, x, y, z = (columns[f"pose.rotation.{i}"] for i in range(4))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([columns["pose.translation.0"], columns["pose.translation.1"], yaw])
