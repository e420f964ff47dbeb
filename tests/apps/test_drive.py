"""Drives along routes: the ramp is taken through the gate, everything is recorded, the recording maps, and what goes wrong has a name."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.drive import DriveRun, drive_scene, judge_drive
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud, Transforms, VelocityCommand
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime.topics import CLOUD, IMU, TRANSFORMS, TRUE_POSE, VELOCITY_COMMAND, VELOCITY_REQUEST, WHEEL_ODOMETRY
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording, recorded_topics
from ambler.wire.trajectory_files import read_tum_3d

UP_THE_RAMP = "frame: start\nspeed: 1.0\npoints: [[0.0, 0.0], [4.0, 0.3], [9.0, 0.0]]\n"
OPTIONS = RunOptions(steps=(), world="ramp", robot="mecanum", seed=4, port=None)


def route_file(folder: Path, text: str = UP_THE_RAMP) -> str:
    path = folder / "route.yaml"
    path.write_text(text)
    return str(path)


def drive(folder: Path, options: RunOptions, route: str, time_limit: float = 60.0) -> DriveRun:
    run = DriveRun(options, drive_scene(options, route, None), RunFolder(folder))
    run.run(time_limit)
    run.close()
    return run


@pytest.fixture(scope="module")
def up_the_ramp(tmp_path_factory: pytest.TempPathFactory) -> DriveRun:
    folder = tmp_path_factory.mktemp("ramp")
    return drive(folder / "run", OPTIONS, route_file(folder))


def test_the_ramp_is_climbed_without_a_collision_and_judged_by_the_truth(up_the_ramp: DriveRun) -> None:
    verdict = judge_drive(up_the_ramp)
    fields = verdict.fields
    assert verdict.is_good
    assert fields["ended"] == "succeeded"
    assert fields["path_length_m"] == pytest.approx(9.0, abs=0.3)
    assert fields["climbed_m"] == pytest.approx(0.6, abs=0.03)
    assert fields["tilt_max_deg"] == pytest.approx(10.0, abs=2.5)
    assert fields["sim_seconds"] == pytest.approx(9.0 + 6.0, abs=3.0)
    stamps_ns, poses = read_tum_3d(up_the_ramp.folder.root / "truth.tum")
    start, mount = up_the_ramp.scene.start, up_the_ramp.scene.robot.model.sensor("imu").base_from_sensor
    assert np.hypot(*(np.array(poses[0].translation[:2]) - (start.x, start.y) - mount.translation[:2])) < 0.01
    assert np.diff(stamps_ns).max() == 20_000_000


def test_what_was_measured_is_recorded_and_every_command_went_through_the_gate(up_the_ramp: DriveRun) -> None:
    recording = up_the_ramp.folder.recording
    topics = recorded_topics(recording)
    for topic in (CLOUD, IMU, WHEEL_ODOMETRY, TRUE_POSE, VELOCITY_REQUEST, VELOCITY_COMMAND):
        assert topic.ros_name in topics, topic.name
    told = list(read_recording(recording, [t.ros_name for t in (CLOUD, VELOCITY_REQUEST, VELOCITY_COMMAND)]))
    clouds = [r.decode_as(PointCloud) for r in told if r.topic == CLOUD.ros_name]
    assert len(clouds) > 100
    assert np.median([len(c.points) for c in clouds]) > 5000
    assert 0.09 < float(clouds[5].time.max()) < 0.1
    asked = [r.decode_as(VelocityCommand).vx for r in told if r.topic == VELOCITY_REQUEST.ros_name]
    sent = [r.decode_as(VelocityCommand).vx for r in told if r.topic == VELOCITY_COMMAND.ros_name]
    assert max(asked) == pytest.approx(1.0, abs=0.01)
    assert 0.0 < max(sent) <= max(asked) + 1e-9


def test_the_recording_maps(up_the_ramp: DriveRun, tmp_path: Path) -> None:
    """With the errors of mount and clock that were drawn; a bar for a way of 9 m in a yard."""
    judge_drive(up_the_ramp)
    folder = up_the_ramp.folder
    out = tmp_path / "lio.json"
    code = main(
        [
            "lio",
            str(folder.recording),
            "--truth",
            str(folder.root / "truth.tum"),
            "--out",
            str(tmp_path / "m"),
            "--json",
            str(out),
        ]
    )
    assert code == 0
    fields = json.loads(out.read_text())
    assert fields["start_rms_m"] < 0.05
    assert fields["path_length_m"] == pytest.approx(9.0, abs=0.3)


def test_a_drive_is_no_run_that_could_be_thought_again(up_the_ramp: DriveRun, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="map its recording with `ambler lio`"):
        replay_run(up_the_ramp.folder.root, tmp_path)


def test_equal_seeds_make_equal_drives_and_another_seed_another(up_the_ramp: DriveRun, tmp_path: Path) -> None:
    def poses(run: DriveRun) -> np.ndarray:
        told = read_recording(run.folder.recording, [TRUE_POSE.ros_name])
        return np.array([(*o.pose.translation, *o.pose.rotation) for o in (r.decode_as(Odometry) for r in told)])

    def first_cloud(run: DriveRun) -> PointCloud:
        return next(r.decode_as(PointCloud) for r in read_recording(run.folder.recording, [CLOUD.ros_name]))

    again = drive(tmp_path / "again", OPTIONS, route_file(tmp_path))
    other = drive(tmp_path / "other", replace(OPTIONS, seed=5), route_file(tmp_path), time_limit=1.0)
    np.testing.assert_array_equal(poses(again), poses(up_the_ramp))
    np.testing.assert_array_equal(first_cloud(again).points, first_cloud(up_the_ramp).points)
    assert first_cloud(other).stamp_ns != first_cloud(again).stamp_ns, "another clock is late by something else"


def test_a_kerb_in_the_way_ends_the_drive_as_blocked(tmp_path: Path) -> None:
    """The kerb lies lower than what the gate looks at; the body meets it, and that is a collision."""
    kerb = load_world("ramp").meshes[0].vertices
    x, y = float(kerb[:, 0].min()), float(kerb[:, 1].mean())
    text = f"points: [[{x - 1.0}, {y}], [{x + 2.0}, {y}]]\nspeed: 0.5\n"
    run = drive(tmp_path / "run", OPTIONS, route_file(tmp_path, text))
    verdict = judge_drive(run)
    assert verdict.fields["ended"] == "blocked"
    assert "did not get on" in verdict.fields["text"]
    assert verdict.fields["collisions"] >= 1
    assert not verdict.is_good


def test_a_hill_is_no_obstacle(tmp_path: Path) -> None:
    """The steepest 11 m of the route of `campus`, up 1.5 m, with a scanner that looks at the floor in front of it."""
    route = np.array(load_world("campus").route)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    hill = route[(along >= 122.0) & (along < 142.0)]
    text = f"points: {hill.tolist()}\nspeed: 1.2\n"
    options = replace(OPTIONS, world="campus", robot="go2")
    fields = judge_drive(drive(tmp_path / "run", options, route_file(tmp_path, text))).fields
    assert (fields["ended"], fields["contacts"]) == ("succeeded", 0)
    assert fields["climbed_m"] > 1.3
    assert fields["tilt_max_deg"] > 12.0


def test_a_drive_that_is_out_of_time_says_so(tmp_path: Path) -> None:
    run = drive(tmp_path / "run", OPTIONS, route_file(tmp_path), time_limit=5.0)
    assert judge_drive(run).fields["ended"] == "time_limit"


@pytest.mark.parametrize(
    ("change", "text", "words"),
    [
        ({"robot": "diff"}, UP_THE_RAMP, "no LiDAR of many rings"),
        ({"is_apart": True}, UP_THE_RAMP, "--apart"),
        ({"start": SE2(3.0, 0.0, 0.0)}, UP_THE_RAMP, "3.0 m from the route's first waypoint"),
        ({}, "points: [[0, 0]]", "points"),
        ({}, "points: [[0, 0], [0, 0.01]]", "10 mm apart"),
        ({}, "points: [[0, 0], [1, .nan]]", "points.1.1"),
        ({}, "points: [[0, 0], [1, 0]]\nspeed: -1", "speed"),
        ({}, "points: [[0, 0], [1, 0]]\nframe: odom", "frame"),
        ({}, "way: [[0, 0], [1, 0]]", "points"),
        ({}, "- 1", "a route is a mapping"),
        ({}, "a: [", "not readable as YAML"),
    ],
)
def test_mistakes_get_one_sentence(tmp_path: Path, change: dict[str, object], text: str, words: str) -> None:
    with pytest.raises(BadInputError, match=words) as told:
        drive_scene(replace(OPTIONS, **change), route_file(tmp_path, text), None)
    assert "\n" not in str(told.value)


def test_worlds_without_a_route_and_files_that_are_not_there_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BadInputError, match="ramp brings no route along"):
        drive_scene(OPTIONS, "built-in", None)
    with pytest.raises(BadInputError, match="cannot be read"):
        drive_scene(OPTIONS, str(tmp_path / "none.yaml"), None)
    common = ["demo", "--world", "campus", "--robot", "go2", "--no-view", "--exit"]
    assert main([*common, "--drive", "built-in", "--then", "1,2"]) == 2
    assert main([*common, "--drive", "built-in", "--speed", "0"]) == 2
    assert main([*common, "--speed", "1"]) == 2
    assert "--speed belongs to a drive" in capsys.readouterr().err


@pytest.mark.parametrize("world", ["campus", "garage", "tunnel"])
def test_every_world_with_a_route_can_be_begun(world: str) -> None:
    scene = drive_scene(replace(OPTIONS, world=world, robot="go2"), "built-in", 1.2)
    assert scene.route.speed == 1.2
    assert scene.start.distance_to(SE2(*scene.route.points[0], 0.0)) == 0.0
    assert scene.route.length > 150.0


DOWN_AGAIN = "frame: start\nspeed: 1.0\npoints: [[8.0, 0.3], [4.0, 0.0], [1.0, 0.2]]\n"
TOP_OF_THE_RAMP = SE3.from_rpy(
    (8.0, 0.3, 0.0), 0.0, 0.0, np.pi
)  # of the base in the cloud, whose heading is that of the first drive


@pytest.fixture(scope="module")
def cloud(up_the_ramp: DriveRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cloud") / "map"
    assert main(["lio", str(up_the_ramp.folder.recording), "--out", str(out)]) == 0
    return out / "cloud.pcd"


def edges_of(run: DriveRun) -> list[tuple[int, SE3]]:
    """Where odom was told to lie in the map, in the order of the recording."""
    told = read_recording(run.folder.recording, [TRANSFORMS.ros_name])
    edges = [e for r in told for e in r.decode_as(Transforms).transforms if e.parent == "map"]
    return [(e.stamp_ns, e.parent_from_child) for e in edges]


def test_with_a_saved_cloud_it_is_localized_while_it_drives_the_same_each_time(cloud: Path, tmp_path: Path) -> None:
    """On another day, with other errors of the plate, the other way round and from elsewhere."""
    options = replace(OPTIONS, seed=9, map_file=cloud)
    route = route_file(tmp_path, DOWN_AGAIN)
    runs = []
    for name in ("one", "two"):
        runs.append(DriveRun(options, drive_scene(options, route, None, TOP_OF_THE_RAMP), RunFolder(tmp_path / name)))
        runs[-1].run(60.0)
        runs[-1].close()
    fields = judge_drive(runs[0]).fields
    assert fields["place"] == "tracking"
    assert fields["place_found_s"] < 4.0
    assert fields["place_rms_m"] < 0.1
    assert len(edges_of(runs[0])) > 50
    assert edges_of(runs[0]) == edges_of(runs[1])


def test_what_does_not_go_with_a_saved_cloud_is_refused(cloud: Path, tmp_path: Path) -> None:
    route = route_file(tmp_path)
    with pytest.raises(BadInputError, match="needs --map"):
        drive_scene(OPTIONS, route, None, TOP_OF_THE_RAMP)
    on_wheels = replace(OPTIONS, map_file=cloud, profile={"odometry_source": "wheels"})
    with pytest.raises(BadInputError, match="odometry_source lidar"):
        drive_scene(on_wheels, route, None)
    cloud_cut = tmp_path / "cut.pcd"
    cloud_cut.write_bytes(cloud.read_bytes()[:2000])
    with pytest.raises(BadInputError, match="cut"):
        drive_scene(replace(OPTIONS, map_file=cloud_cut), route, None)
    assert main(["demo", "--map", str(cloud), "--no-view"]) == 2
