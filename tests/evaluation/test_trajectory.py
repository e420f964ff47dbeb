"""Trajectory errors and collisions against values that are known beforehand."""

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, VelocityCommand
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import find_collisions, split_shoved
from ambler.evaluation.trajectory import trajectory_error
from ambler.wire.mcap_file import McapRecorder


def circle(stamps_ns: np.ndarray) -> np.ndarray:
    t = stamps_ns * 1e-9
    return np.stack([3 * np.cos(0.2 * t), 3 * np.sin(0.2 * t), 0.2 * t + math.pi / 2], axis=1)


SQUARE = 0.5 * np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
TRUTH_NS = np.arange(0, 60_000_000_000, 10_000_000)
STAMPS_NS = np.arange(123_456_789, 59_000_000_000, 200_000_000)


def test_the_truth_itself_has_no_error() -> None:
    result = trajectory_error(STAMPS_NS, circle(STAMPS_NS), TRUTH_NS, circle(TRUTH_NS))
    assert result.ate_rms_m < 1e-5
    assert result.unaligned_rms_m < 1e-5
    assert result.yaw_rms_rad < 1e-5
    assert len(result.errors) == len(STAMPS_NS)


def test_another_frame_is_aligned_away_but_reported() -> None:
    motion = SE2(1.0, -2.0, 0.7)
    estimate = circle(STAMPS_NS)
    estimate[:, :2] = motion.transform(estimate[:, :2])
    estimate[:, 2] += motion.yaw
    result = trajectory_error(STAMPS_NS, estimate, TRUTH_NS, circle(TRUTH_NS))
    assert result.ate_rms_m < 1e-5
    assert result.yaw_rms_rad < 1e-5
    assert result.unaligned_rms_m > 1.0
    assert result.truth_from_estimate.as_array() == pytest.approx(motion.inverse().as_array(), abs=1e-5)


def test_noise_of_known_size_is_measured() -> None:
    rng = np.random.default_rng(5)
    estimate = circle(STAMPS_NS)
    estimate[:, :2] += rng.normal(scale=0.05, size=(len(estimate), 2))
    result = trajectory_error(STAMPS_NS, estimate, TRUTH_NS, circle(TRUTH_NS))
    assert result.ate_rms_m == pytest.approx(0.05 * math.sqrt(2), rel=0.1)
    assert result.ate_rms_m <= result.unaligned_rms_m


def test_stamps_in_a_gap_of_the_truth_are_left_out() -> None:
    keep = (TRUTH_NS < 20_000_000_000) | (TRUTH_NS > 30_000_000_000)
    result = trajectory_error(STAMPS_NS, circle(STAMPS_NS), TRUTH_NS[keep], circle(TRUTH_NS[keep]))
    assert not ((result.stamps_ns > 20_000_000_000) & (result.stamps_ns < 30_000_000_000)).any()
    assert result.ate_rms_m < 1e-5


def test_no_common_time_is_refused() -> None:
    with pytest.raises(BadInputError, match="have a true pose"):
        trajectory_error(STAMPS_NS + 10**12, circle(STAMPS_NS), TRUTH_NS, circle(TRUTH_NS))


def contact(seconds: float, speed: float, other: str = "wall", approach: float | None = None) -> Contact:
    return Contact(round(seconds * 1e9), "base", other, (0.0, 0.0, 0.0), speed, 10.0 * speed, approach)


def test_contacts_cluster_into_collisions() -> None:
    times = [(1.0, 0.3), (1.2, 0.6), (1.6, 0.2), (2.2, 0.3), (5.0, 0.04), (9.0, 0.2)]
    found = find_collisions([contact(t, v) for t, v in times])
    assert [(c.begin_ns, c.end_ns) for c in found] == [
        (1_000_000_000, 1_600_000_000),
        (2_200_000_000, 2_200_000_000),
        (9_000_000_000, 9_000_000_000),
    ]
    assert found[0].speed == 0.6
    assert found[0].force == pytest.approx(6.0)


def test_resting_contacts_and_docks_are_no_collisions() -> None:
    assert find_collisions([contact(1.0, 0.05), contact(2.0, 0.0)]) == ()
    assert find_collisions([contact(1.0, 0.2, "dock")], allowed=frozenset({"dock"})) == ()


@pytest.mark.parametrize(
    ("moved_at", "touched_by", "turning", "is_shoved"),
    [
        *((None, "ann", 0.0, True), (8.0, "ann", 0.2, True), (10.05, "ann", 0.2, True), (9.95, "ann", 0.09, True)),
        *(
            (9.5, "ann", 0.11, False),
            (9.95, "ann", 0.11, False),
            (None, "bob", 0.0, False),
            (None, "nobody", 0.0, False),
        ),
    ],
)
def test_a_robot_that_stood_and_that_somebody_else_touched_was_shoved(
    tmp_path: Path, moved_at: float | None, touched_by: str, turning: float, *, is_shoved: bool
) -> None:
    """Into Bob; one that was told to stand and still rolls into him was not, and one whose corners crept at less than 0.05 m/s stood."""
    recorder = McapRecorder(tmp_path / "run")
    for k in range(160, 220):
        is_moving = moved_at is not None and k == round(20 * moved_at)
        stamp_ns = k * 50_000_000
        recorder.write("/cmd_vel", VelocityCommand(stamp_ns, wz=turning * is_moving), stamp_ns)
    recorder.close()
    contacts = [contact(10.01, 0.2, "bob", 0.2)]
    if touched_by != "nobody":
        contacts.insert(0, contact(9.8, 0.0, touched_by, 0.0))
    caused, shoved = split_shoved(find_collisions(contacts), contacts, tmp_path / "run", SQUARE)
    assert (len(caused), len(shoved)) == ((0, 1) if is_shoved else (1, 0))


def test_of_a_robot_of_whose_commands_nothing_is_known_nobody_says_that_it_was_shoved(tmp_path: Path) -> None:
    recorder = McapRecorder(tmp_path / "run")
    recorder.write("/cmd_vel", VelocityCommand(0), 0)
    recorder.close()
    contacts = [contact(9.8, 0.0, "ann", 0.0), contact(10.0, 0.2, "bob", 0.2)]
    caused, shoved = split_shoved(find_collisions(contacts), contacts, tmp_path / "run", SQUARE)
    assert (len(caused), len(shoved)) == (1, 0)
    assert split_shoved((), (), tmp_path / "nothing", SQUARE) == ((), ())


def test_a_contact_at_a_tenth_of_a_metre_per_second_is_a_collision_and_at_a_hundredth_is_none() -> None:
    assert [c.speed for c in find_collisions([contact(1.0, 0.1)])] == [0.1]
    assert [c.speed for c in find_collisions([contact(1.0, 0.06)])] == [0.06]
    assert find_collisions([contact(1.0, 0.04), contact(2.0, 0.01)]) == ()


def test_a_true_heading_that_is_told_within_one_turn_is_interpolated_over_its_cut() -> None:
    """The truth comes ten times a second, its headings between -180 and 180 degrees; the robot turns at 1 rad/s."""
    truth_ns = np.arange(0, 20_000_000_000, 100_000_000)
    stamps_ns = truth_ns[:-1] + 37_000_000

    def spin(stamps: np.ndarray) -> np.ndarray:
        yaw = 1e-9 * stamps
        return np.column_stack([np.cos(yaw), np.sin(yaw), np.arctan2(np.sin(yaw), np.cos(yaw))])

    result = trajectory_error(stamps_ns, spin(stamps_ns), truth_ns, spin(truth_ns))
    assert len(result.errors) == len(stamps_ns)
    assert result.yaw_rms_rad < 1e-3
