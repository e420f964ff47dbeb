"""A recorder that stalls: clouds and inertial measurements stop together while the body goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import spatial_error
from ambler.lio.cloud_match import CloudMatch
from ambler.lio.config import HoleConfig, LioConfig
from ambler.lio.hole import PlaceSearch, Whereabouts, stands_out, whereabouts
from ambler.lio.inertial_buffer import InertialBuffer
from ambler.lio.offline import OfflineLio, run_offline
from ambler.lio.state import FilterState
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_rig import RigScan
from tests.lio.carried import scans_of, walk


def error_of(result: OfflineLio, recorded: tuple[RigScan, ...]) -> float:
    stamps = np.array([s.end_ns for s in recorded])
    return spatial_error(result.stamps_ns, result.poses, stamps, [s.world_from_imu for s in recorded]).start_rms_m


@pytest.mark.parametrize("gap", [4, 20])
def test_after_a_hole_the_place_is_found_again_in_the_own_map(gap: int) -> None:
    """Carried across by what lay on both sides of it, the walk ended 19 and 101 m off, and no scan was lost."""
    rig, recorded = walk()
    kept = recorded[:120] + recorded[120 + gap :]
    result = run_offline(scans_of(kept), LioConfig(), rig.told_mount)
    assert error_of(result, kept) < 0.02
    assert [hole.is_regained for hole in result.holes] == [True]
    assert result.is_sure
    assert any("found again" in line for line in result.warnings())


def test_a_short_hole_is_bridged() -> None:
    rig, recorded = walk()
    kept = recorded[:120] + recorded[122:]
    result = run_offline(scans_of(kept), LioConfig(), rig.told_mount)
    assert not result.holes
    assert error_of(result, kept) < 0.02


def test_a_place_that_is_not_found_again_is_said_to_be_lost() -> None:
    """What comes after the hole was seen in a building of another size."""
    rig, recorded = walk()
    scans = scans_of(recorded[:100] + recorded[120:180])
    scans[100:] = [replace(s, cloud=replace(s.cloud, points=s.cloud.points * np.float32(1.4))) for s in scans[100:]]
    result = run_offline(scans, LioConfig(), rig.told_mount)
    assert not result.is_sure
    assert [(hole.is_regained, hole.scans) for hole in result.holes] == [(False, 60)]
    assert any("not found again" in line and "last 60 scans are lost" in line for line in result.warnings())


def test_clouds_that_stop_while_the_imu_goes_on_leave_no_hole() -> None:
    rig, recorded = walk()
    late = tuple(sample for scan in recorded[100:115] for sample in scan.imu)
    scans = scans_of(recorded[:100] + recorded[115:])
    scans[100] = CloudScan(scans[100].cloud, (*late, *scans[100].imu), ())
    assert not run_offline(scans, LioConfig(), rig.told_mount).holes


def test_a_map_of_next_to_nothing_tells_no_place() -> None:
    search = PlaceSearch(np.zeros((3, 3)), Whereabouts(SE3(), 1.0, 1.0), LioConfig())
    assert search._relocalizer is None


def test_a_hole_is_as_long_as_there_is_no_sample() -> None:
    buffer = InertialBuffer()
    buffer.add(Imu(round(t * 1e9), "imu", (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)) for t in (0.0, 1.0, 1.5, 4.0))
    assert buffer.longest_hole(0.2, 3.0) == pytest.approx(1.5)
    assert buffer.longest_hole(2.0, 2.3) == pytest.approx(0.3)
    assert buffer.longest_hole(2.0, 1.0) == 0.0


def test_where_a_body_may_be_grows_with_the_hole_and_turns_with_what_it_turned_since() -> None:
    was = FilterState(velocity=np.array([1.0, 0.0, 0.0]))
    since = FilterState(velocity=np.array([0.5, 0.0, 0.0]))
    about = whereabouts(was, 0.0, 2.0, since, 1.0, 0.5 * np.pi, LioConfig())
    np.testing.assert_allclose(about.map_from_imu.translation, (2.0, 0.5, 0.0), atol=1e-12)
    assert about.map_from_imu.to_se2().yaw == pytest.approx(0.5 * np.pi)
    c = HoleConfig()
    assert about.way == pytest.approx(c.way_least + 2.0 * c.speed_more)
    assert about.turn == pytest.approx(c.turn_least + 2.0 * c.rate_more)
    assert whereabouts(was, 1.0, 60.0, since, 1.0, 0.0, LioConfig()).turn == np.pi


def test_a_place_stands_out_by_what_it_explains_not_by_how_tightly() -> None:
    def match(walls: float, tightness: float) -> CloudMatch:
        return CloudMatch(SE3(), walls, 0.9, 0.0, 0.03, np.eye(6), tightness)

    assert stands_out((match(0.8, 1.0), match(0.5, 1.0)), 0.08)
    assert not stands_out((match(0.8, 1.0), match(0.84, 0.7)), 0.08)


def test_a_hole_of_no_length_is_refused() -> None:
    with pytest.raises(BadInputError, match="hole bridged"):
        HoleConfig(bridged=0.0)
