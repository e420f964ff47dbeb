"""Errors and consistency of a localization, from CSV files whose statistics are known beforehand."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.localization_quality import LocalizationErrors, localization_errors

STAMPS_NS = 5_000_000_000 + np.arange(600) * 100_000_000
MAP_FROM_TRUTH = SE2(4.0, -7.0, 2.2)
COVARIANCE = 1e-4 * np.array([[4.0, 2.5, 1.0], [2.5, 6.0, -1.0], [1.0, -1.0, 2.0]])


def write_poses(path: Path, poses: np.ndarray, covariance: np.ndarray | None = None) -> Path:
    """Write a CSV as a recording's odometry gives it: planar poses (N, 3), with the covariance's (x, y, yaw) in its 6 x 6."""
    full = np.full((6, 6), 7.0)  # what belongs to z, roll and pitch must not matter
    if covariance is not None:
        full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    header = ["log_time_ns", "stamp_ns", *(f"pose.translation.{k}" for k in range(3))]
    header += [*(f"pose.rotation.{k}" for k in range(4)), *(f"pose_covariance.{k}" for k in range(36))]
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        for stamp, (x, y, yaw) in zip(STAMPS_NS.tolist(), poses.tolist(), strict=True):
            quaternion = [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]
            writer.writerow([stamp + 1, stamp, x, y, 0.1, *quaternion, *full.ravel().tolist()])
    return path


def true_poses() -> np.ndarray:
    """A circle in the map, driven so long that its heading passes 180 degrees several times."""
    t = (STAMPS_NS - STAMPS_NS[0]) * 1e-9
    return np.column_stack([2.0 * np.cos(0.4 * t), 2.0 * np.sin(0.4 * t), 0.4 * t + 0.5 * math.pi])


def measured(folder: Path, errors: np.ndarray, covariance: np.ndarray = COVARIANCE) -> LocalizationErrors:
    """Write the truth in its own frame and estimates that are off it by `errors` along the map's axes; compare them."""
    poses = true_poses()
    truth = np.array([(MAP_FROM_TRUTH.inverse() @ SE2.from_array(p)).as_array() for p in poses])
    told = write_poses(folder / "told.csv", poses + errors, covariance)
    return localization_errors(told, write_poses(folder / "truth.csv", truth), MAP_FROM_TRUTH)


def test_errors_drawn_from_the_told_covariance_have_a_nees_of_one(tmp_path: Path) -> None:
    errors = np.random.default_rng(1).multivariate_normal(np.zeros(3), COVARIANCE, len(STAMPS_NS))
    found = measured(tmp_path, errors)
    count = 3 * len(found.nees)
    low, high = stats.chi2.ppf([0.001, 0.999], count) / count
    assert low < found.nees.mean() < high
    share_95 = float((3.0 * found.nees < stats.chi2.ppf(0.95, 3)).mean())
    assert share_95 == pytest.approx(0.95, abs=0.03), "not only the mean: the whole distribution is that of chi-squared"
    assert found.rms == pytest.approx(np.sqrt(np.diag(COVARIANCE)), rel=0.1)
    assert found.variances == pytest.approx(np.tile(np.diag(COVARIANCE), (len(found.nees), 1)))


def test_the_ellipse_of_one_sigma_has_a_third_of_a_nees_everywhere(tmp_path: Path) -> None:
    """An error of one sigma along any axis of the ellipsoid is worth 1/3 per dimension, however the axes lie."""
    values, vectors = np.linalg.eigh(COVARIANCE)
    for k in range(3):
        folder = tmp_path / str(k)
        folder.mkdir()
        error = math.sqrt(values[k]) * vectors[:, k]
        assert measured(folder, np.tile(error, (len(STAMPS_NS), 1))).nees == pytest.approx(1.0 / 3.0, rel=0.01)


def test_a_covariance_four_times_too_small_has_a_nees_of_four(tmp_path: Path) -> None:
    errors = np.random.default_rng(2).multivariate_normal(np.zeros(3), COVARIANCE, len(STAMPS_NS))
    assert measured(tmp_path, errors, 0.25 * COVARIANCE).nees.mean() == pytest.approx(4.0, rel=0.15)


def test_an_offset_that_never_changes_is_an_error(tmp_path: Path) -> None:
    offset = np.array([0.05, -0.03, 0.02])
    found = measured(tmp_path, np.tile(offset, (len(STAMPS_NS), 1)))
    assert found.rms == pytest.approx(np.abs(offset), rel=1e-3)
    assert found.errors.mean(axis=0) == pytest.approx(offset, rel=1e-3)


def test_the_settling_second_does_not_count_and_nothing_left_is_refused(tmp_path: Path) -> None:
    errors = np.zeros((len(STAMPS_NS), 3))
    errors[:10, 0] = 5.0  # the first second
    found = measured(tmp_path, errors)
    assert found.stamps_ns[0] == STAMPS_NS[10]
    assert np.abs(found.errors).max() < 1e-3
    with pytest.raises(BadInputError, match="truth is known"):
        localization_errors(tmp_path / "told.csv", tmp_path / "truth.csv", settle=1e4)


def test_several_drives_are_joined(tmp_path: Path) -> None:
    zero = measured(tmp_path, np.zeros((len(STAMPS_NS), 3)))
    off = measured(tmp_path, np.tile([0.1, 0.0, 0.0], (len(STAMPS_NS), 1)))
    joined = LocalizationErrors.joined([zero, off])
    assert len(joined.nees) == 2 * len(zero.nees)
    assert joined.rms[0] == pytest.approx(0.1 / math.sqrt(2.0), rel=1e-3)
