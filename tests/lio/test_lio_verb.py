"""`ambler lio` on a recording of our own and on folders of clouds, and what it says to bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import spatial_error
from ambler.lio.config import LioConfig
from ambler.lio.offline import run_offline
from ambler.recordings.cloud_scan import CloudScan, ScanJoiner
from ambler.wire.cloud_files import read_cloud, write_cloud
from ambler.wire.trajectory_files import read_tum_3d, write_tum_3d
from tests.lio.carried import save_clouds, save_recording, scans_of, walk


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    save_recording(folder / "recording", folder / "truth.tum")
    return folder


def test_a_recording_becomes_trajectory_clouds_pictures_and_report(recorded: Path, tmp_path: Path) -> None:
    out, result = tmp_path / "out", tmp_path / "r.json"
    words = ["lio", str(recorded / "recording"), "--out", str(out), "--truth", str(recorded / "truth.tum"), "--json", str(result)]  # fmt: skip
    words += ["--set", "lio.loops.way_least=15", "--set", "lio.loops.keyframe_m=2.5", "--set", "lio.loops.gain_least=0"]
    assert main(words) == 0
    fields = json.loads(result.read_text())
    assert fields["loop_closures"] >= 3
    assert len(read_tum_3d(out / "odometry.tum")[0]) == fields["poses"]
    assert fields["start_rms_m"] < 0.02
    assert fields["rpe_trans_pct"] < 1.0
    assert fields["scans_lost"] == 0
    assert fields["is_converged"]
    assert fields["odometry_start_rms_m"] < 0.02
    stamps, poses = read_tum_3d(out / "trajectory.tum")
    assert len(poses) == fields["poses"] == len(stamps)
    assert np.loadtxt(out / "trajectory.kitti").shape == (len(poses), 12)
    assert len(read_cloud(out / "cloud.pcd")) == len(read_cloud(out / "cloud.ply")) == fields["points"] > 5000
    for name in ("top.png", "side.png", "error.png", "report.html"):
        assert (out / name).stat().st_size > 5000


def test_a_reference_of_other_attitudes_is_told(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps, poses = read_tum_3d(recorded / "truth.tum")
    turned = [SE3(p.translation, (p.rotation[3], *p.rotation[:3])) for p in poses]  # as if w came first
    write_tum_3d(tmp_path / "wxyz.tum", stamps, turned)
    words = ["lio", str(recorded / "recording"), "--out", str(tmp_path / "out"), "--truth", str(tmp_path / "wxyz.tum")]
    assert main(words) == 0
    assert "the attitudes of the reference may be others" in capsys.readouterr().out


def test_without_an_imu_it_refuses_and_names_the_way_out(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["lio", str(recorded / "recording"), "--imu-topic", "none", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "no inertial measurements" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--cloud-topic", "/nowhere"], "--cloud-topic /nowhere: no PointCloud there"),
        (["--imu-topic", "/nowhere"], "--imu-topic /nowhere: no Imu there"),
        (["--mount", "1,2,3"], "is not X,Y,Z,ROLL,PITCH,YAW"),
        (["--mount", "0,0,0,180,0,0"], "other axes"),
        (["--cell", "0"], "--cell 0.0"),
        (["--set", "lio.nothing=1"], "lio.nothing"),
        (["--truth", "/nowhere.tum"], "No such file"),
    ],
)
def test_bad_input_is_one_clear_line(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], text: str
) -> None:
    assert main(["lio", str(recorded / "recording"), "--out", str(tmp_path / "out"), *words]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_of_clouds_is_mapped_and_a_cut_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, scans = walk()
    folder = tmp_path / "clouds"
    save_clouds(folder, scans[:60])
    words = ["lio", str(folder), "--no-imu", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    assert "60 of 60 scans" in capsys.readouterr().out
    data = (folder / "30.pcd").read_bytes()
    (folder / "30.pcd").write_bytes(data[: len(data) // 2])
    assert main([*words[:-1], str(tmp_path / "other")]) == 1
    printed = capsys.readouterr().out
    assert "ends early, what came before is mapped" in printed
    assert "30.pcd: is no cloud, or cut off" in printed
    assert "30 of 30 scans" in printed
    assert (tmp_path / "other" / "report.html").exists()
    empty = tmp_path / "empty"
    empty.mkdir()
    write_cloud(empty / "0.pcd", np.zeros((0, 3), np.float32))
    (empty / "times.txt").write_text("1.0")
    assert main(["lio", str(empty), "--no-imu", "--out", str(tmp_path / "other")]) == 2
    assert "nothing could be mapped" in capsys.readouterr().err


def test_a_long_way_without_a_closure_and_an_unsolved_graph_are_told() -> None:
    rig, scans = walk()
    result = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    assert result.is_converged
    assert not any("loop" in warning for warning in result.warnings())
    far = tuple(SE3((5.0 * k, 0.0, 0.0)) for k in range(len(result.poses)))
    assert any(warning.startswith("no loop closure in ") for warning in replace(result, poses=far).warnings())
    assert not any("loop" in warning for warning in replace(result, poses=far, seeks_loops=False).warnings())
    assert any("did not converge" in warning for warning in replace(result, is_converged=False).warnings())
    doubtful = result.covariances.copy()
    doubtful[3, :3, :3] = [[2.0, 0.0, 0.0], [0.0, 5.0, 4.0], [0.0, 4.0, 5.0]]  # 3 m along a diagonal
    told = replace(result, degenerate=7, covariances=doubtful).warnings()
    assert any(line.startswith("7 scans left a direction") and "3.00 m at worst" in line for line in told)


def test_the_mount_is_refined_for_all_poses() -> None:
    rig, scans = walk()
    told = rig.mount @ SE3.from_rpy((0.0, 0.0, 0.0), 0.005, -0.004, 0.003)
    plain, refined = (run_offline(scans_of(scans), LioConfig(refines_mount=r), told) for r in (False, True))
    truth = [s.world_from_imu for s in scans]
    stamps = np.array([s.end_ns for s in scans])
    errors = [spatial_error(r.stamps_ns, r.poses, stamps, truth).rotation_rms_deg for r in (plain, refined)]
    assert errors[1] < 0.7 * errors[0]
    off = (rig.mount.inverse() @ refined.imu_from_lidar).rotation
    assert 2.0 * np.linalg.norm(off[1:]) < 0.6 * 2.0 * np.linalg.norm((rig.mount.inverse() @ told).rotation[1:])


def with_clock(clock: float) -> list[CloudScan]:
    """The walk by a LiDAR whose stamps lag behind the IMU's, joined by who was told so."""
    joiner = ScanJoiner(waits_for_odometry=False, lidar_clock=clock)
    given: list[CloudScan] = []
    for scan in walk()[1]:
        for sample in scan.imu:
            joiner.add(replace(sample, stamp_ns=sample.stamp_ns + round(clock * 1e9)))
        joiner.add(scan.cloud)
        given += joiner.ready()
    return given


@pytest.mark.parametrize("clock", [0.06, -0.06])
def test_a_told_difference_of_the_clocks_takes_no_measurement_away(clock: float) -> None:
    """Scans came with what was measured until their ends by the LiDAR's clock: the last 60 ms of each were guessed."""
    rig, scans = walk()
    result = run_offline(with_clock(clock), LioConfig(lidar_clock=clock), rig.told_mount)
    truth = [s.world_from_imu for s in scans]
    error = spatial_error(result.stamps_ns, result.poses, np.array([s.end_ns for s in scans]), truth)
    assert result.gaps == 0
    assert error.start_rms_m < 0.02
    assert result.clock_off is None


@pytest.mark.parametrize("clock", [0.05, -0.05, 0.02])
def test_a_difference_of_the_clocks_that_nobody_told_is_named_with_the_cure(clock: float) -> None:
    """The LiDAR alone is followed too coarsely to see it at the start; the filter knows it well after hundreds of scans."""
    rig, scans = walk()
    result = run_offline(with_clock(clock), LioConfig(), rig.told_mount)
    assert result.clock_off == pytest.approx(clock, abs=0.015)
    assert any(f"lidar_clock={result.clock_off:.3f}" in warning for warning in result.warnings())
    sound = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    assert sound.clock_off is None
