"""The node: the robot's own sensors at their places, contradictions that end it, states that are told once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ambler.apps.config import default_config
from ambler.apps.robot import sensing_nodes
from ambler.core.errors import BadInputError
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig, LoopConfig
from ambler.lio.start import LioInputError
from ambler.nodes.lidar_odometry import LidarOdometryNode
from ambler.nodes.terrain import TerrainNode
from ambler.perception.air_filter import AirFilterConfig
from ambler.robots.catalog import robot_model
from ambler.runtime.tasks import SAVE_CLOUD, SaveMapRequest
from ambler.runtime.topics import (
    CLOUD,
    IMU,
    ODOMETRY,
    REGISTERED_CLOUD,
    REGISTERED_VIEW,
    STATUS,
    TRAJECTORY,
    TRANSFORMS,
)
from ambler.sim.hand_rig import IMU_FRAME, LIDAR_FRAME
from ambler.wire.cloud_files import read_cloud
from tests.hand_made_context import HandMadeContext
from tests.lio.carried import walk

BASE_FROM_IMU = SE3.from_rpy((0.1, 0.0, 0.9), 0.0, 0.0, 0.5)


def robot() -> RobotModel:
    """A base that carries the plate of the walk."""
    rig, _ = walk()
    mounts = (
        SensorMount(IMU_FRAME, SensorKind.IMU, BASE_FROM_IMU),
        SensorMount("spare", SensorKind.IMU, SE3()),
        SensorMount(LIDAR_FRAME, SensorKind.CLOUD, BASE_FROM_IMU @ rig.told_mount),
    )
    box = np.array([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]])
    return RobotModel("box", DriveKind.OMNI, box, VelocityLimits(), mounts)


def driven(
    scans: int,
    rate: float = 1.0,
    gap: range = range(0),
    config: LioConfig | None = None,
    closes_loops: bool = False,
    air: AirFilterConfig | None = None,
    hole: range = range(0),
) -> HandMadeContext:
    """Play the walk; `rate` multiplies the gyroscope, clouds of `gap` hold nothing but noise far from everything, in the `hole` neither LiDAR nor IMU says anything."""
    _, recorded = walk()
    context = HandMadeContext()
    context.start(LidarOdometryNode(robot(), config, air, closes_loops=closes_loops))
    for number, scan in enumerate(recorded[:scans]):
        if number in hole:
            continue
        cloud = scan.cloud
        if number in gap:
            noise = np.random.default_rng(number).normal(0.0, 30.0, cloud.points.shape)
            cloud = replace(cloud, points=noise.astype(np.float32))
        context.callbacks[CLOUD.name](cloud)
        for sample in scan.imu:
            context.run(max(0.0, 1e-9 * (sample.stamp_ns + 10_000_000_000 - context.now_ns)))
            turned = tuple(rate * w for w in sample.angular_velocity)
            context.callbacks[IMU.name](replace(sample, angular_velocity=turned))
            spare = replace(
                sample, stamp_ns=sample.stamp_ns + 1_000_000, frame="spare", angular_velocity=(9.0, 9.0, 9.0)
            )
            context.callbacks[IMU.name](spare)
    return context


def test_odometry_its_edge_and_the_registered_cloud_agree_with_the_walk() -> None:
    rig, recorded = walk()
    context = driven(90, air=AirFilterConfig(is_used=False))
    odometry = context.messages(ODOMETRY)
    edges = [m.transforms[0] for m in context.messages(TRANSFORMS)]
    assert [(e.stamp_ns, e.parent_from_child) for e in edges] == [(m.stamp_ns, m.pose) for m in odometry]
    first, last = odometry[0], odometry[-1]
    way = (rig.pose_at(first.stamp_ns) @ BASE_FROM_IMU.inverse()).inverse() @ (
        rig.pose_at(last.stamp_ns) @ BASE_FROM_IMU.inverse()
    )
    assert (first.pose.inverse() @ last.pose).translation == pytest.approx(way.translation, abs=0.03)
    assert np.linalg.norm(way.translation) > 5.0
    cloud = context.messages(REGISTERED_CLOUD)[-1]
    scan = next(s for s in recorded if s.end_ns == cloud.stamp_ns)
    odom_from_world = first.pose @ (rig.pose_at(first.stamp_ns) @ BASE_FROM_IMU.inverse()).inverse()
    end = odom_from_world @ scan.world_from_imu @ rig.mount
    last_points = scan.cloud.points[-30:]  # taken where the scan ended
    assert cloud.frame == "odom"
    assert cloud.points[-30:] == pytest.approx(end.transform(last_points), abs=0.1)
    assert len(cloud.points) == len(cloud.intensity) == len(scan.cloud.points)


def test_the_registered_cloud_is_thin_for_viewers_and_without_dust_for_all() -> None:
    _, recorded = walk()
    context = driven(60)
    whole, thin = context.messages(REGISTERED_CLOUD), context.messages(REGISTERED_VIEW)
    sizes = {s.end_ns: len(s.cloud.points) for s in recorded}
    assert min(len(cloud.points) / sizes[cloud.stamp_ns] for cloud in whole) > 0.93  # clear air
    assert len(thin) == -(-len(whole) // 2)
    view = thin[-1]
    assert 100 < len(view.points) < 0.9 * len(whole[-1].points)
    cells = np.floor(view.points.astype(np.float64) / 0.2)
    assert len(np.unique(cells, axis=0)) == len(view.points)
    assert REGISTERED_CLOUD.is_bulk
    assert not REGISTERED_VIEW.is_bulk


def test_a_gyroscope_in_degrees_ends_it_by_name() -> None:
    with pytest.raises(LioInputError, match="degrees per second"):
        driven(120, rate=180.0 / np.pi)


def test_scans_that_fit_nothing_are_told_and_so_is_the_way_back() -> None:
    context = driven(90, gap=range(60, 75))
    codes = [m.code for m in context.messages(STATUS)]
    assert codes == ["LIO_GOOD", "LIO_LOST", "LIO_GOOD"]
    stamps = np.array([m.stamp_ns for m in context.messages(ODOMETRY)])
    assert 0.3 < np.diff(stamps).max() * 1e-9 < 0.7  # of 1.5 s without a scan that fits, one was coasted


def test_a_hole_in_all_measurements_is_told_and_silences_odometry_until_the_place_is_found() -> None:
    context = driven(190, hole=range(120, 124))
    codes = [message.code for message in context.messages(STATUS)]
    assert codes == ["LIO_GOOD", "LIO_ASTRAY", "LIO_GOOD"]
    stamps = np.array([message.stamp_ns for message in context.messages(ODOMETRY)])
    assert np.diff(stamps).max() > 2e9, "silent while it is looked for"


def test_loops_are_closed_while_it_drives_and_the_map_begins_where_odom_does() -> None:
    rig, recorded = walk()
    eager = replace(LioConfig(), loops=LoopConfig(keyframe_m=2.0, way_least=10.0))
    context = driven(len(recorded), config=eager, closes_loops=True)
    edges = [e for m in context.messages(TRANSFORMS) for e in m.transforms if e.parent == "map"]
    path = context.messages(TRAJECTORY)[-1]
    assert any(code == "LIO_LOOP_CLOSED" for code, _ in context.logged)
    assert len(edges) > len(recorded) / 15
    assert max(np.linalg.norm(e.parent_from_child.translation) for e in edges) < 0.05
    assert edges[-1].parent_from_child != edges[0].parent_from_child
    odom_from_world = (rig.pose_at(context.messages(ODOMETRY)[0].stamp_ns) @ BASE_FROM_IMU.inverse()).inverse()
    truth = np.array([(odom_from_world @ s.world_from_imu @ rig.mount).translation[:2] for s in recorded])
    off = [np.linalg.norm(truth - place, axis=1).min() for place in path.poses[:, :2]]
    assert len(off) > 8
    assert max(off) < 0.1  # keyframes lie on the way
    assert path.frame == "map"


def test_what_its_keyframes_saw_is_saved_where_it_lies_in_the_map(tmp_path: Path) -> None:
    rig, recorded = walk()
    eager = replace(LioConfig(), loops=LoopConfig(keyframe_m=2.0, way_least=10.0))
    context = driven(len(recorded), config=eager, closes_loops=True)
    context.services[SAVE_CLOUD.name](SaveMapRequest(str(tmp_path / "map")))
    saved = read_cloud(tmp_path / "map.cloud.pcd")
    points = np.column_stack([saved[axis] for axis in "xyz"]).astype(np.float64)
    assert len(points) > 5000
    map_from_world = (rig.pose_at(context.messages(ODOMETRY)[0].stamp_ns) @ BASE_FROM_IMU.inverse()).inverse()
    tree = cKDTree(points)
    for scan in recorded[
        40::80
    ]:  # what was seen from all over the walk is there, in the frame that began under the base
        end = scan.cloud.points[-300:]  # taken where the scan ended
        seen = (map_from_world @ scan.world_from_imu @ rig.mount).transform(end[np.linalg.norm(end, axis=1) < 15.0])
        assert np.median(tree.query(seen)[0]) < 0.15


def test_before_the_first_keyframe_there_is_no_cloud_and_who_closes_no_loops_saves_none(tmp_path: Path) -> None:
    context = driven(5, closes_loops=True)
    with pytest.raises(BadInputError, match="no keyframe"):
        context.services[SAVE_CLOUD.name](SaveMapRequest(str(tmp_path / "map")))
    assert SAVE_CLOUD.name not in driven(5).services


def test_only_who_is_asked_tells_where_odom_lies_in_the_map() -> None:
    context = driven(40)
    assert not [e for m in context.messages(TRANSFORMS) for e in m.transforms if e.parent == "map"]
    assert context.messages(TRAJECTORY) == []


def test_a_robot_without_such_sensors_is_refused_before_anything_runs() -> None:
    diff = robot_model("diff")
    with pytest.raises(BadInputError, match="diff needs a LiDAR"):
        sensing_nodes(diff, replace(default_config(diff), odometry_source="lidar"))
    with pytest.raises(BadInputError, match="LiDAR-inertial"):
        LidarOdometryNode(diff)


def test_the_source_is_chosen_by_the_configuration() -> None:
    spot = robot_model("spot")
    nodes = sensing_nodes(spot, replace(default_config(spot), odometry_source="lidar"))
    assert [type(node) for node in nodes] == [LidarOdometryNode, TerrainNode]
    plain = sensing_nodes(spot, replace(default_config(spot), odometry_source="lidar", terrain="never"))
    assert [type(node) for node in plain] == [LidarOdometryNode]
