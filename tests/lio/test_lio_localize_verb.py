"""`ambler lio --map`: a recording localized in the cloud that another run of `ambler lio` has saved, and what it says to bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.lio.config import LioConfig
from ambler.lio.offline import run_offline
from ambler.wire.cloud_files import write_cloud
from ambler.wire.trajectory_files import read_tum_3d, write_tum_3d
from tests.lio.carried import scans_of, walk
from tests.lio.test_lio_verb import recorded

__all__ = ["recorded"]


@pytest.fixture(scope="module")
def cloud(recorded: Path) -> Path:
    """The map of the walk, and beside it the true poses in the map's frame."""
    rig, scans = walk()
    result = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    write_cloud(recorded / "cloud.pcd", result.cloud)
    first = next(s for s in scans if s.end_ns == int(result.stamps_ns[0]))
    map_from_world = result.poses[0] @ first.world_from_imu.inverse()
    poses = [map_from_world @ s.world_from_imu for s in scans]
    write_tum_3d(recorded / "in_map.tum", [s.end_ns for s in scans], poses)
    return recorded / "cloud.pcd"


@pytest.mark.parametrize("guess", [["--guess=0.8,-0.6,0,20"], []])
def test_a_recording_is_localized_and_compared_in_the_frame_of_the_map(
    recorded: Path, cloud: Path, tmp_path: Path, guess: list[str]
) -> None:
    out, result = tmp_path / "out", tmp_path / "r.json"
    words = ["lio", str(recorded / "recording"), "--map", str(cloud), *guess, "--out", str(out), "--json", str(result)]
    assert main([*words, "--truth", str(recorded / "in_map.tum")]) == 0
    fields = json.loads(result.read_text())
    assert fields["success"] is True
    assert fields["found_after_s"] < (0.6 if guess else 20.0)  # the hall is bare and nearly square: it takes viewpoints
    assert fields["map_error_max_m"] < 0.06
    assert fields["times_lost"] == 0
    stamps, poses = read_tum_3d(out / "trajectory.tum")
    assert len(stamps) == len(poses) == fields["poses"] > (200 if guess else 40)
    for name in ("top.png", "report.html"):
        assert (out / name).stat().st_size > 5000


def test_a_reference_of_other_times_is_told_and_ends_with_1(
    recorded: Path, cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps, poses = read_tum_3d(recorded / "in_map.tum")
    write_tum_3d(tmp_path / "later.tum", stamps + 10**12, poses)
    words = ["lio", str(recorded / "recording"), "--map", str(cloud), "--guess=0.8,-0.6,0,20", "--out", str(tmp_path / "out")]  # fmt: skip
    assert main([*words, "--truth", str(tmp_path / "later.tum"), "--json", str(tmp_path / "r.json")]) == 1
    assert re.search(r"warning: .*later\.tum: only 0 of \d+ poses have a true pose", capsys.readouterr().out)
    fields = json.loads((tmp_path / "r.json").read_text())
    assert fields["success"] is True
    assert "map_error_rms_m" not in fields
    assert (tmp_path / "out" / "trajectory.tum").exists()


def test_a_place_that_is_not_in_the_map_is_told_and_ends_with_1(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(2)
    walls = [
        np.column_stack([np.full(4000, x), rng.uniform(-9.0, 9.0, 4000), rng.uniform(0.0, 3.0, 4000)])
        for x in (-9.0, 9.0)
    ]
    floor = np.column_stack([rng.uniform(-9.0, 9.0, (9000, 2)), np.zeros(9000)])
    write_cloud(tmp_path / "other.pcd", np.vstack([*walls, floor]).astype(np.float32))
    words = ["lio", str(recorded / "recording"), "--map", str(tmp_path / "other.pcd"), "--out", str(tmp_path / "out")]
    assert main([*words, "--json", str(tmp_path / "r.json")]) == 1
    assert "the place was not found" in capsys.readouterr().out
    fields = json.loads((tmp_path / "r.json").read_text())
    assert fields["success"] is False
    assert fields["found_after_s"] is None


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--guess", "1,2,3,4"], "--guess needs --map"),
        (["--map", "{cloud}", "--guess", "1,2,3"], "is not X,Y,Z,YAW"),
        (["--map", "{cloud}", "--guess", "1,2,nan,4"], "not finite"),
        (["--map", "/nowhere.pcd"], "cannot be read"),
        (["--map", "{cut}"], "cut off"),
        (["--map", "{cloud}", "--peer"], "not with --map"),
    ],
)
def test_bad_input_is_one_clear_line(
    recorded: Path, cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], text: str
) -> None:
    cut = tmp_path / "cut.pcd"
    cut.write_bytes(cloud.read_bytes()[:-1000])
    filled = [word.format(cloud=cloud, cut=cut) for word in words]
    assert main(["lio", str(recorded / "recording"), "--out", str(tmp_path / "out"), *filled]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
