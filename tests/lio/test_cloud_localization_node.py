"""The node that finds a robot in a saved cloud: from nothing, from a guess, not in another place, lost when nothing fits, equal every time."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud, PoseStamped, TransformStamped
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.lio.cloud_match import apart
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.odometry import LidarInertialOdometry
from ambler.nodes.cloud_localization import CloudLocalizationNode
from ambler.robots.catalog import robot_model
from ambler.runtime.topics import LOCALIZED_POSE, MAP_CLOUD, ODOMETRY, REGISTERED_CLOUD, SET_POSE, STATUS, TRANSFORMS
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import LIDAR_FRAME, HandRig
from ambler.sim.site import draw_hall
from tests.hand_made_context import HandMadeContext
from tests.lio.carried import SMALL, scans_of, walk
from tests.lio.test_cloud_localization import other_day, saved

BASE_FROM_IMU = SE3.from_rpy((0.1, 0.0, 0.9), 0.0, 0.0, 0.5)
AHEAD_NS = 10_000_000_000  # the context's clock runs before the walk's
Told = Sequence[tuple[LioResult, SE3]]


def robot() -> RobotModel:
    rig, _ = walk()
    mount = SensorMount(LIDAR_FRAME, SensorKind.CLOUD, BASE_FROM_IMU @ rig.told_mount)
    box = np.array([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]])
    return RobotModel("box", DriveKind.OMNI, box, VelocityLimits(), (mount,))


def play(context: HandMadeContext, results: Told) -> None:
    """Publish what the odometry's node would: the registered cloud 20 ms late, odometry before and after its stamp."""
    for result, _ in results:
        pose = result.map_from_imu @ BASE_FROM_IMU.inverse()
        points = result.map_from_imu.transform(result.points_imu).astype(np.float32)
        n, zero = len(points), np.zeros(len(points), np.float32)
        for late_ns in (-5_000_000, 0, 5_000_000):
            stamp_ns = result.stamp_ns + late_ns
            context.run(max(0.0, 1e-9 * (stamp_ns + AHEAD_NS - context.now_ns)))
            told = Odometry(stamp_ns, "odom", "base", pose, (0.0,) * 3, (0.0,) * 3, np.eye(6), np.eye(6))
            context.callbacks[ODOMETRY.name](told)
        context.run(0.02)
        cloud = PointCloud(result.stamp_ns, "odom", points, zero, zero.copy(), np.zeros(n, np.uint16))
        context.callbacks[REGISTERED_CLOUD.name](cloud)
    context.run(2.0)


def begun(guess: SE3 | None = None) -> HandMadeContext:
    context = HandMadeContext()
    context.start(CloudLocalizationNode(robot(), saved(), guess=guess))
    return context


def edges(context: HandMadeContext) -> list[TransformStamped]:
    return [e for m in context.messages(TRANSFORMS) for e in m.transforms]


def codes(context: HandMadeContext) -> list[str]:
    return [m.code for m in context.messages(STATUS)]


def errors(told: Sequence[TransformStamped], results: Told) -> list[float]:
    """Metres between where the base is told to be and where it is."""
    known = {result.stamp_ns: (result.map_from_imu, truth) for result, truth in results}
    base = BASE_FROM_IMU.inverse()
    return [apart(known[e.stamp_ns][1] @ base, e.parent_from_child @ known[e.stamp_ns][0] @ base)[0] for e in told]


@functools.cache
def kidnapped() -> HandMadeContext:
    context = begun()
    play(context, other_day())
    return context


@functools.cache
def elsewhere(scans: int = 110) -> Told:
    """A walk in a hall that the map does not show."""
    site = draw_hall(8, 25.0)
    rig = HandRig(site.world, HandPath(site.way), SMALL, 5)
    odometry = LidarInertialOdometry(LioConfig(), rig.told_mount)
    results = [odometry.update(given) for given in scans_of(tuple(s for s, _ in zip(rig.scans(), range(scans), strict=False)))]  # fmt: skip
    return tuple((result, SE3()) for result in results if result is not None)


def test_a_robot_that_begins_anywhere_finds_its_place_and_keeps_it() -> None:
    context, results = kidnapped(), other_day()
    assert codes(context)[0] == "CLOUD_GATHERING"
    assert codes(context)[-2:] == ["CLOUD_FOUND", "CLOUD_TRACKING"]
    told = edges(context)
    assert len(told) > 20
    assert (told[0].parent, told[0].child) == ("map", "odom")
    assert max(errors(told, results)) < 0.08
    poses = {result.stamp_ns: result.map_from_imu for result, _ in results}
    shown = np.array([(e.parent_from_child @ poses[e.stamp_ns]).translation for e in told])
    steps = np.linalg.norm(np.diff(shown, axis=0), axis=1)
    assert steps[1:].max() < 0.25  # those of a walk; at first it walked on for a second while it was searched
    assert len(context.messages(MAP_CLOUD)[0].points) > 500


def test_nothing_is_told_before_the_place_is_found() -> None:
    context = kidnapped()
    found_ns = next(at for at, topic, m in context.published if topic == STATUS and m.code == "CLOUD_FOUND")
    assert min(at for at, topic, _ in context.published if topic == TRANSFORMS) >= found_ns


def test_the_pose_of_the_base_is_told_with_its_covariance_about_the_axes_of_the_map() -> None:
    context = kidnapped()
    known = {result.stamp_ns: truth @ BASE_FROM_IMU.inverse() for result, truth in other_day()}
    told = context.messages(LOCALIZED_POSE)
    assert [m.stamp_ns for m in told] == [e.stamp_ns for e in edges(context)]
    assert max(apart(known[m.stamp_ns], m.pose)[0] for m in told) < 0.08
    for message in told:
        covariance = message.pose_covariance
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    first, last = (np.sqrt(np.diag(m.pose_covariance)) for m in (told[0], told[-1]))
    assert (last[:3] < 0.05).all()
    assert (last < first).all(), "following the place says more than finding it"
    off = np.array([np.subtract(m.pose.translation, known[m.stamp_ns].translation) for m in told[10:]])
    sigma = np.array([np.sqrt(np.diag(m.pose_covariance))[:3] for m in told[10:]])
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 5.0


def test_equal_inputs_give_equal_places() -> None:
    again = begun()
    play(again, other_day())
    assert [(at, e.stamp_ns, e.parent_from_child) for (at, t, m) in again.published if t == TRANSFORMS for e in m.transforms] == [
        (at, e.stamp_ns, e.parent_from_child) for (at, t, m) in kidnapped().published if t == TRANSFORMS for e in m.transforms
    ]  # fmt: skip


def test_another_place_is_refused() -> None:
    context = begun()
    play(context, elsewhere())
    assert edges(context) == []
    assert not {"CLOUD_FOUND", "CLOUD_TRACKING"} & set(codes(context))


@pytest.mark.parametrize("is_set_by_people", [False, True])
def test_a_guess_of_the_base_decides_at_the_first_sight(is_set_by_people: bool) -> None:
    results = other_day()[:40]
    true = results[0][1] @ BASE_FROM_IMU.inverse()
    guess = true @ SE3.from_rpy((1.2, -0.9, 0.3), 0.0, 0.0, 0.4)
    context = begun(None if is_set_by_people else guess)
    if is_set_by_people:
        context.callbacks[SET_POSE.name](PoseStamped(0, "odom", SE3()))  # not in the map: it says nothing
        context.callbacks[SET_POSE.name](PoseStamped(0, "map", guess))
    play(context, results)
    assert "CLOUD_FOUND" in codes(context)
    assert max(errors(edges(context), results)) < 0.1


def test_what_fits_nothing_any_more_is_lost_and_no_longer_told() -> None:
    results = other_day()
    context = begun(results[0][1] @ BASE_FROM_IMU.inverse())
    play(context, results[:40])
    assert codes(context)[-1] == "CLOUD_TRACKING"
    last = results[39][0]
    rng = np.random.default_rng(5)
    blown = [
        (
            replace(last, stamp_ns=last.stamp_ns + (k + 1) * 100_000_000, points_imu=rng.normal(0.0, 8.0, (1500, 3))),
            SE3(),
        )
        for k in range(125)
    ]
    play(context, blown)
    assert "CLOUD_LOST" in codes(context)
    lost_ns = next(at for at, topic, m in context.published if topic == STATUS and m.code == "CLOUD_LOST")
    assert max(at for at, topic, _ in context.published if topic == TRANSFORMS) < lost_ns


def test_a_robot_without_a_lidar_of_many_rings_is_refused() -> None:
    with pytest.raises(BadInputError, match="needs a LiDAR that gives clouds"):
        CloudLocalizationNode(robot_model("diff"), saved())
