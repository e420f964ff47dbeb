"""Truth in a bent map is that of the nearest keyframe, and what a scan determines is what its walls tell."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.determined import determined_directions
from ambler.evaluation.made_map_truth import MadeMapTruth
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms


def test_a_stiff_map_only_moves_the_poses() -> None:
    rng = np.random.default_rng(3)
    map_from_world = SE2(4.0, -2.0, 2.5)
    true = np.column_stack([rng.uniform(-9.0, 9.0, (40, 2)), rng.uniform(-3.0, 3.0, 40)])
    told = np.array([(map_from_world @ SE2.from_array(row)).as_array() for row in true])
    truth = MadeMapTruth(true, told)
    for row in np.column_stack([rng.uniform(-9.0, 9.0, (20, 2)), rng.uniform(-3.0, 3.0, 20)]):
        expected, got = map_from_world @ SE2.from_array(row), truth.pose(SE2.from_array(row))
        assert got.distance_to(expected) < 1e-12
        assert abs(math.sin(got.yaw - expected.yaw)) < 1e-12


def test_each_pose_takes_the_error_of_the_keyframe_beside_it() -> None:
    true = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    told = np.array([[0.0, 0.0, 0.0], [10.05, 0.02, 0.01]])  # the far end of the map is bent
    poses = MadeMapTruth(true, told).poses(np.array([[1.0, 0.5, 0.3], [9.0, 0.0, 0.3]]))
    assert poses[0] == pytest.approx([1.0, 0.5, 0.3])
    assert poses[1] == pytest.approx([10.05 - math.cos(0.01), 0.02 - math.sin(0.01), 0.31])


def test_keyframes_without_their_truth_are_refused() -> None:
    with pytest.raises(BadInputError, match="3 keyframes, and the truth of 2"):
        MadeMapTruth(np.zeros((2, 3)), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("room", "at", "expected"), [(rooms.office(), (2.0, 4.5), 2.0), (rooms.corridor(), (30.0, 1.0), 1.0)]
)
def test_a_corridor_determines_one_direction_and_an_office_two(
    room: rooms.Room, at: tuple[float, float], expected: float
) -> None:
    surfaces, pose = SurfaceMap.from_occupancy(*room.occupancy()), SE2(*at, 0.4)
    known = determined_directions(surfaces, room.scan(pose, np.random.default_rng(1), reach=15.0), pose.as_array())
    assert np.trace(known) == pytest.approx(expected, abs=0.05)
    assert known[1, 1] == pytest.approx(1.0, abs=0.05)  # across the corridor, which lies along x


def test_no_return_determines_nothing() -> None:
    surfaces = SurfaceMap.from_occupancy(*rooms.office().occupancy())
    assert not determined_directions(surfaces, np.empty((0, 2), np.float32), np.array([2.0, 4.5, 0.0])).any()
