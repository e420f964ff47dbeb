"""Where on its path is the robot: a path at even spacing, progress that never jumps to another leg of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import InvalidPathError
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.path_place import end_of_stretch, place_on_path

F64 = NDArray[np.float64]

SPACING = 0.05
REACH = 1.0  # metres of path within which the robot is looked for, once it was found
SAME_GOAL = (0.1, 0.3)  # metres and radians that a correction of the map moves a goal by; one farther away is another
SAME_SHAPE = 0.3  # metres
TURN_BACK = 2.0  # radians of turning after which a path counts as leading back
TURN_BACK_MIN = 0.5  # metres of path that are always seen


class PathTracker:
    """Holds a path in the odom frame as points (P, 4) of (x, y, arc length, heading), and the robot's arc length on it."""

    def __init__(self) -> None:
        self.points = np.zeros((0, 4))
        self.goal = SE2()
        self.along = 0.0
        self._is_located = False
        self._given = np.zeros((0, 3))

    @property
    def length(self) -> float:
        """Length of the whole path, metres."""
        return float(self.points[-1, 2])

    def set_path(self, path_odom: F64) -> bool:
        """Take a path (N, 3); returns whether it leads to the same goal as before. Raises InvalidPathError."""
        if path_odom.ndim != 2 or path_odom.shape[1] != 3 or len(path_odom) == 0:
            raise InvalidPathError("a path needs at least one pose (x, y, yaw)")
        if np.array_equal(path_odom, self._given):
            return True
        if not np.isfinite(path_odom).all():
            raise InvalidPathError("the path holds values that are no numbers")
        self._given = path_odom.copy()
        goal = SE2.from_array(path_odom[-1])
        is_same = len(self.points) > 0 and goal.distance_to(self.goal) < SAME_GOAL[0]
        is_same = is_same and abs(wrap_angle(goal.yaw - self.goal.yaw)) < SAME_GOAL[1]
        points = _evenly_spaced(path_odom)
        is_same_shape = is_same and len(points) == len(self.points)
        if is_same_shape:
            is_same_shape = bool(np.all(np.hypot(*(points - self.points)[:, :2].T) < SAME_SHAPE))
        self.points, self.goal = points, goal
        self._is_located = self._is_located and is_same_shape
        return is_same

    def locate(self, odom_from_base: SE2) -> float:
        """Find the robot's place on the path, near its last one; returns the arc length that is left, metres."""
        reach = REACH if self._is_located else math.inf
        self.along = float(place_on_path(self.points, odom_from_base.x, odom_from_base.y, SPACING, self.along, reach))
        self._is_located = True
        return self.length - self.along

    def ahead(self, distance: float) -> F64:
        """Return the points from just behind the robot to `distance` metres ahead of it, at most to where the path turns back."""
        s = self.points[:, 2]
        first = max(0, int(np.searchsorted(s, self.along, side="right")) - 2)
        seen = self.along + TURN_BACK_MIN
        return self.points[first : end_of_stretch(self.points, first, self.along + distance, TURN_BACK, seen)]

    def point_at(self, distance: float) -> tuple[float, float]:
        """Return the point of the path `distance` metres ahead of the robot, or its end."""
        s = self.along + distance
        return float(np.interp(s, self.points[:, 2], self.points[:, 0])), float(
            np.interp(s, self.points[:, 2], self.points[:, 1])
        )


def _evenly_spaced(path: F64) -> F64:
    step = np.hypot(np.diff(path[:, 0]), np.diff(path[:, 1]))
    is_new = np.concatenate(([True], step > 1e-6))
    xy = path[is_new, :2]
    s = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(xy[:, 0]), np.diff(xy[:, 1])))))
    count = max(1, math.ceil(s[-1] / SPACING)) + 1 if s[-1] > 0.0 else 1
    at = np.linspace(0.0, s[-1], count)
    out = np.empty((count, 4))
    out[:, 0], out[:, 1], out[:, 2] = np.interp(at, s, xy[:, 0]), np.interp(at, s, xy[:, 1]), at
    if count == 1:
        out[:, 3] = path[-1, 2]
        return out
    heading = np.arctan2(np.diff(out[:, 1]), np.diff(out[:, 0]))
    out[:-1, 3], out[-1, 3] = heading, heading[-1]
    return out
