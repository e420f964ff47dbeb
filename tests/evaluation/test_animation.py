"""The animated picture shows the map the right way up, and the robot where it was at that time."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.animation import ROBOT, animate
from ambler.runtime.topics import MAP, SLAM_POSE
from ambler.wire.mcap_file import McapRecorder

SPEC = GridSpec(0.1, 100, 60, -1.0, -2.0)  # 10 x 6 m: x from -1 to 9, y from -2 to 4
S = 1_000_000_000


def record(folder: Path) -> Path:
    """The robot moves along x at 1 m/s from (0, 1); a wall is at y from 3 to 3.5 m; the right half becomes known after 4 s."""
    recorder = McapRecorder(folder)
    for second in range(9):
        data = np.zeros(SPEC.shape, np.int8)
        data[50:55] = 100
        if second < 4:
            data[:, 50:] = -1
        now_ns = second * S
        recorder.write(MAP.ros_name, OccupancyGrid(now_ns, "map", SPEC, data), now_ns)
        pose = SE3.from_se2(SE2(float(second), 1.0, 0.0))
        recorder.write(SLAM_POSE.ros_name, PoseStamped(now_ns + 1, "map", pose), now_ns + 1)
    recorder.close()
    return folder


def pictures(path: Path) -> list[np.ndarray]:
    with Image.open(path) as image:
        out = []
        for k in range(image.n_frames):
            image.seek(k)
            out.append(np.array(image.convert("RGB")).astype(int))
    return out


def robot_place(picture: np.ndarray) -> tuple[float, float]:
    """The middle of what has the robot's colour, metres; the frame shows 0.5 m more than the map on all sides."""
    rows, columns = np.nonzero(np.abs(picture - ROBOT).max(axis=2) < 40)
    scale = picture.shape[1] / 11.0
    return columns.mean() / scale - 1.5, 4.5 - rows.mean() / scale


def test_it_shows_the_robot_where_it_was_and_the_map_the_right_way_up(tmp_path: Path) -> None:
    shown = pictures(animate(record(tmp_path / "recording"), tmp_path / "a.gif", frames=8, width=440))
    assert 8 <= len(shown) <= 10
    places = np.array([robot_place(picture) for picture in shown])
    np.testing.assert_allclose(places[:, 1], 1.0, atol=0.15)
    assert (np.diff(places[:-1, 0]) > 0.5).all()
    assert places[-1, 0] == pytest.approx(8.0, abs=0.25)
    wall, opposite = shown[-1][round(1.25 * 40), 200], shown[-1][round(5.75 * 40), 200]
    assert wall.max() < 80
    assert opposite.min() > 240
    right = (round(3.0 * 40), 400)
    assert shown[0][right].max() < 240, "not known yet"
    assert shown[-1][right].min() > 240


def test_a_recording_without_a_map_is_refused(tmp_path: Path) -> None:
    recorder = McapRecorder(tmp_path / "recording")
    recorder.write(SLAM_POSE.ros_name, PoseStamped(0, "map", SE3()), 0)
    recorder.close()
    with pytest.raises(BadInputError, match="no map"):
        animate(tmp_path / "recording", tmp_path / "a.gif")
    assert not (tmp_path / "a.gif").exists()
