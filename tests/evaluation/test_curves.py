"""Curves of reports: the largest error is found where it is, and the speed of a walking robot is that of its body."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.evaluation.curves import draw_errors, speed_over_ground, worst_mark

STAMPS = 5_000_000_000 + np.arange(0, 20_000_000_000, 20_000_000)


def walk(sway: float) -> np.ndarray:
    """Ten seconds of rest, ten of 0.5 m/s along x, swaying to the side with 3 Hz."""
    t = (STAMPS - STAMPS[0]) * 1e-9
    return np.column_stack([0.5 * np.maximum(t - 10.0, 0.0), sway * np.sin(6.0 * np.pi * t), np.zeros_like(t)])


def test_a_gait_does_not_show_in_the_speed() -> None:
    poses = walk(0.02)
    raw = np.hypot(*np.diff(poses[:, :2], axis=0).T) / 0.02
    assert np.ptp(raw[600:]) > 0.1, "what was drawn before is a saw"
    speed = speed_over_ground(STAMPS, poses)
    assert speed[50:450].max() < 0.02
    assert speed[550:] == pytest.approx(0.5, abs=0.01)


def test_the_largest_error_is_marked_where_and_when_it_was(tmp_path: Path) -> None:
    errors = np.full(len(STAMPS), 0.01)
    errors[700] = 0.27
    mark = worst_mark(STAMPS, errors, walk(0.0), int(STAMPS[0]))
    assert mark.text == "largest error 27.0 cm at 14.0 s"
    assert (mark.x, mark.y) == pytest.approx((2.0, 0.0))

    def red(path: Path) -> np.ndarray:
        picture = cv2.imread(str(path)).astype(int)
        return np.argwhere((picture[:, :, 2] > 200) & (picture[:, :, 1] < 60) & (picture[:, :, 0] < 60))

    late = red(draw_errors(tmp_path / "e.png", STAMPS, errors, int(STAMPS[0])))
    early = red(draw_errors(tmp_path / "f.png", STAMPS, errors[::-1].copy(), int(STAMPS[0])))
    assert len(late) > 100
    assert early[:, 1].min() < late[:, 1].max() - 100
