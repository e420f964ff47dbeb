"""A recording as an animated picture: the map as it grows, where the robot is, where it has been and where it wants to go."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_OCCUPIED
from ambler.core.messages import OccupancyGrid, Odometry, PoseStamped
from ambler.core.messages import Path as PathMessage
from ambler.core.se2 import SE2
from ambler.evaluation.map_quality import FREE_UP_TO
from ambler.evaluation.pictures import FREE_SHADE, OCCUPIED_SHADE, UNDECIDED_SHADE, UNKNOWN_SHADE, known_box
from ambler.runtime import topics
from ambler.wire.atomic_file import write_whole
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

U8 = NDArray[np.uint8]

TRAIL, PLAN, ROBOT = (37, 99, 235), (249, 115, 22), (220, 38, 38)  # RGB
ROBOT_LENGTH = 0.6  # metres of the triangle that stands for the robot
LINE = cv2.LINE_AA
_TOPICS = (topics.MAP, topics.SLAM_POSE, topics.LOCALIZED_POSE, topics.PATH)


@dataclass(slots=True)
class _Scene:
    """What is known at one instant."""

    occupancy: OccupancyGrid
    trail: list[tuple[float, float]] = field(default_factory=list)
    robot: SE2 | None = None
    plan: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))


def animate(recording: Path, path: Path, frames: int = 80, width: int = 640, seconds: float = 10.0) -> Path:
    """Write a GIF of about `frames` pictures, `width` pixels wide, that plays for `seconds`. Raises BadInputError when the recording cannot
    be read or holds no map."""
    begin_ns, end_ns, last = _span(recording)
    view = _View(last, width)
    every_ns = max(1, (end_ns - begin_ns) // max(1, frames))
    pictures = [view.draw(scene) for scene in _scenes(recording, begin_ns, every_ns)]
    images = [Image.fromarray(picture).quantize(64) for picture in (*pictures, pictures[-1])]
    each_ms = max(20, round(1e3 * seconds / len(images)))
    durations = [each_ms] * (len(images) - 1) + [1500]  # the last picture stays for a while
    gif = io.BytesIO()
    images[0].save(gif, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=True)
    write_whole(path, gif.getvalue())
    return path


def _span(recording: Path) -> tuple[int, int, OccupancyGrid]:
    """Return the instants of the first and the last map, and the last map."""
    stamps, last = [], None
    for recorded in read_recording(recording, [topics.MAP.ros_name]):
        stamps.append(recorded.log_time_ns)
        last = recorded
    if last is None:
        raise BadInputError(f"{recording}: it holds no map")
    return stamps[0], stamps[-1], last.decode_as(OccupancyGrid)


def _scenes(recording: Path, begin_ns: int, every_ns: int) -> Iterator[_Scene]:
    """Yield the scene at every instant of the animation."""
    scene, due_ns = None, begin_ns + every_ns
    for recorded in read_recording(recording, [t.ros_name for t in _TOPICS]):
        message = decode(topics.topic_named(recorded.topic).type, recorded.data)
        if isinstance(message, OccupancyGrid):
            if scene is None:
                scene = _Scene(message)
            scene.occupancy = message
        elif scene is None:
            continue
        elif isinstance(message, PoseStamped | Odometry):
            scene.robot = message.pose.to_se2()
            scene.trail.append((scene.robot.x, scene.robot.y))
        elif isinstance(message, PathMessage):
            scene.plan = message.poses
        if recorded.log_time_ns >= due_ns:
            due_ns += every_ns
            yield scene
    if scene is not None:
        yield scene


class _View:
    """Draws scenes into one frame: the box of what the last map knows."""

    def __init__(self, last: OccupancyGrid, width: int) -> None:
        self._x0, x1, y0, self._y1 = known_box(last.spec, last.data)
        self._scale = width / (x1 - self._x0)
        self._shape = (round((self._y1 - y0) * self._scale), width)

    def draw(self, scene: _Scene) -> U8:
        """Return a picture uint8 (H, W, 3), RGB, y upwards."""
        picture = self._floor(scene.occupancy)
        cv2.polylines(picture, [self._pixels(np.array(scene.trail).reshape(-1, 2))], False, TRAIL, 2, LINE)
        cv2.polylines(picture, [self._pixels(scene.plan[:, :2])], False, PLAN, 2, LINE)
        if scene.robot is not None:
            half = 0.5 * ROBOT_LENGTH
            corners = scene.robot.transform(np.array([(half, 0.0), (-half, 0.7 * half), (-half, -0.7 * half)]))
            cv2.fillPoly(picture, [self._pixels(corners)], ROBOT, LINE)
        return picture

    def _floor(self, occupancy: OccupancyGrid) -> U8:
        data, spec = occupancy.data, occupancy.spec
        height, width = self._shape
        xs = self._x0 + (np.arange(width) + 0.5) / self._scale
        ys = self._y1 - (np.arange(height) + 0.5) / self._scale
        ix = np.floor((xs - spec.origin_x) / spec.resolution).astype(int)
        iy = np.floor((ys - spec.origin_y) / spec.resolution).astype(int)
        inside = ((iy >= 0) & (iy < spec.height))[:, None] & ((ix >= 0) & (ix < spec.width))[None, :]
        values = np.where(inside, data[np.clip(iy, 0, spec.height - 1)][:, np.clip(ix, 0, spec.width - 1)], -1)
        picture = np.empty((*self._shape, 3), np.uint8)
        picture[:] = UNDECIDED_SHADE
        picture[values < 0] = UNKNOWN_SHADE
        picture[(values >= 0) & (values <= FREE_UP_TO)] = FREE_SHADE
        picture[values >= OCC_OCCUPIED] = OCCUPIED_SHADE
        return picture

    def _pixels(self, points: NDArray[np.floating]) -> NDArray[np.int32]:
        """Pixels int32 (N, 2) of points (N, 2), metres in the map frame."""
        columns = (points[:, 0] - self._x0) * self._scale
        rows = (self._y1 - points[:, 1]) * self._scale
        finite = np.stack([columns, rows], axis=1)
        return np.asarray(np.round(finite[np.isfinite(finite).all(axis=1)]).astype(np.int32))
