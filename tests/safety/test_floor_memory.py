"""Slopes whose foot a scanner cannot see: the gate remembers the floor that it drove towards."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest

from ambler.core.messages import PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.safety.blind_memory import BlindMemory
from ambler.safety.field_of_view import FieldOfView
from ambler.safety.floor_memory import FloorMemory
from ambler.safety.points import Floor, points_of_cloud

MOUNT = SE3((0.0, 0.0, 0.78))
BAND, REACH, SLOPE = (0.15, 0.9), 3.6, math.tan(math.radians(22.0))
RINGS = np.radians(np.arange(-15.0, 16.0, 2.0))  # of a VLP-16: the lowest meets level floor 2.9 m away


def height_at(x: np.ndarray) -> np.ndarray:
    """A floor that is level up to 3 m and rises by 10 degrees from there."""
    return np.maximum(0.0, x - 3.0) * math.tan(math.radians(10.0))


def scan_at(x: float, box: tuple[float, float] | None = None) -> PointCloud:
    """What 16 rings see ahead from a level body at `x`; a box stands at `box` (x, height)."""
    ranges = np.arange(0.3, 6.0, 0.005)
    points = []
    base = float(height_at(np.array([x]))[0])
    for azimuth in np.radians(np.arange(-20.0, 20.0, 0.5)):
        for elevation in RINGS:
            far, z = ranges * math.cos(elevation), base + 0.78 + ranges * math.sin(elevation)
            at = x + far * math.cos(azimuth)
            hit = z <= height_at(at)
            if box is not None:
                hit |= (at >= box[0]) & (at <= box[0] + 0.5) & (z <= height_at(at) + box[1])
            if hit.any():
                k = int(np.argmax(hit))
                points.append((far[k] * math.cos(azimuth), far[k] * math.sin(azimuth), ranges[k] * math.sin(elevation)))
    zeros = np.zeros(len(points), np.float32)
    return PointCloud(0, "lidar", np.array(points, np.float32), zeros, zeros, np.zeros(len(points), np.uint16))


def obstacles_on_the_way(places: np.ndarray, memory: FloorMemory, box: tuple[float, float] | None = None) -> list[int]:
    """How many points of each scan are obstacles, on a drive through places (x)."""
    counts = []
    for x in places.tolist():
        level = SE3((x, 0.0, float(height_at(np.array([x]))[0])))
        floor = Floor(SLOPE, REACH, 0.6, (0.0, 0.0), memory, level)
        counts.append(len(points_of_cloud(scan_at(x, box), [MOUNT], np.zeros(3), REACH, BAND, floor)))
    return counts


DRIVE = np.arange(0.0, 2.5, 0.1)


def test_a_slope_that_begins_where_the_scanner_sees_no_floor_is_no_obstacle_for_who_drove_there() -> None:
    assert obstacles_on_the_way(DRIVE, FloorMemory(REACH, 12.0))[-1] == 0
    assert obstacles_on_the_way(DRIVE[-1:], FloorMemory(REACH, 12.0))[-1] > 50, "without a memory it may be anything"


def test_what_stands_on_the_slope_is_one_all_the_same() -> None:
    counts = obstacles_on_the_way(DRIVE, FloorMemory(REACH, 12.0), (4.5, 0.35))
    assert min(counts[-8:]) > 30


def test_what_comes_to_stand_on_remembered_floor_is_an_obstacle() -> None:
    memory = FloorMemory(REACH, 12.0)
    obstacles_on_the_way(DRIVE, memory)
    assert obstacles_on_the_way(DRIVE[-1:], memory, (4.4, 0.3))[0] > 30


def test_the_floor_is_forgotten_after_a_while() -> None:
    memory = FloorMemory(8.0, 2.0)
    obstacles_on_the_way(DRIVE, memory)
    nothing = np.array([[5.0, 5.0, 0.0]])
    kept = [memory.update(nothing, SE3((2.5 + 0.1 * k, 0.0, 0.0)), 0.6) for k in range(21)]
    assert len(kept[0]) > 300
    assert len(kept[-1]) < 20


def test_what_is_far_away_is_forgotten() -> None:
    memory = FloorMemory(REACH, 100.0)
    memory.update(np.array([[2.0, 0.0, 0.0], [-3.0, 0.0, 0.0]]), SE3(), 0.6)
    kept = memory.update(np.array([[1.0, 3.0, 0.0]]), SE3((1.0, 0.0, 0.0)), 0.6)
    assert kept == pytest.approx(np.array([[1.0, 0.0, 0.0]]))


def test_where_odometry_jumps_everything_is_forgotten() -> None:
    """Floor that seems to lie 0.3 m higher than it does would hide what stands on it."""
    memory = FloorMemory(REACH, 12.0)
    obstacles_on_the_way(DRIVE, memory)
    points = MOUNT.transform(scan_at(2.4).points.astype(np.float64))
    assert len(memory.update(points, SE3((2.4, 0.0, 0.0)), 0.6)) > 300
    assert len(memory.update(points, SE3((2.4, 0.0, -0.3)), 0.6)) == 0


def test_the_body_of_the_robot_is_no_floor() -> None:
    memory = FloorMemory(REACH, 12.0)
    leg = np.array([[0.3, 0.2, 0.1], [0.3, -0.2, 0.1]])
    memory.update(leg, SE3(), 0.6)
    assert len(memory.update(np.array([[3.0, 0.0, 0.0]]), SE3((1.0, 0.0, 0.0)), 0.6)) == 0


def test_points_come_back_where_they_are_from_another_place_and_heading() -> None:
    memory = FloorMemory(REACH, 12.0)
    memory.update(np.array([[2.0, 1.0, 0.1]]), SE3.from_rpy((1.0, 0.0, 0.2), 0.0, 0.0, 0.5 * math.pi), 0.6)
    kept = memory.update(np.array([[9.0, 9.0, 0.0]]), SE3((0.0, 0.0, 0.1)), 0.6)
    assert kept == pytest.approx(np.array([[0.0, 2.0, 0.2]]))


def remembered_on_the_way(places: np.ndarray, box: tuple[float, float] | None) -> list[np.ndarray]:
    """What the gate still holds of what it cannot see any more, on a drive through places (x)."""
    floor_memory, blind, kept = FloorMemory(REACH, 12.0), BlindMemory(0.6, 12.0), []
    field = FieldOfView(0.4, elevation=(math.radians(-15.0), math.radians(15.0)))
    for x in places.tolist():
        height = float(height_at(np.array([x]))[0])
        floor = Floor(SLOPE, REACH, 0.6, (0.0, 0.0), floor_memory, SE3((x, 0.0, height)))
        points = points_of_cloud(scan_at(x, box), [MOUNT], np.zeros(3), REACH, BAND, floor)
        is_floor = partial(floor.holds, within=BAND[0])
        kept.append(blind.update(points, SE2(x, 0.0), MOUNT, field, (), 0.0, height, is_floor))
    return kept


def test_what_looked_like_an_obstacle_from_afar_and_proves_to_be_floor_is_let_go() -> None:
    """It stands where the slope before it is hidden, drives on, and comes to know it."""
    kept = remembered_on_the_way(np.arange(2.0, 3.6, 0.05), None)
    assert max(len(points) for points in kept) > 20
    assert len(kept[-1]) == 0


def test_a_low_box_that_is_hidden_below_the_beams_is_held() -> None:
    kept = remembered_on_the_way(np.arange(0.0, 2.2, 0.05), (3.0, 0.3))
    front = kept[-1][np.abs(kept[-1][:, 0] - (3.0 - 2.15)) < 0.1]
    assert len(front) > 5


def test_what_stands_lower_than_any_floor_that_was_found_is_held() -> None:
    """A robot that has climbed away from it does not know the floor there: the height of its own is told instead."""
    floor = Floor(SLOPE, REACH, 0.6, (0.0, 0.0), FloorMemory(REACH, 12.0), SE3())
    floor.find(np.array([[3.0, 0.0, 0.0]]))
    behind, below = np.array([[-0.8, 0.0, 0.02]]), np.array([[-0.8, 0.0, -0.5]])
    assert floor.holds(behind, BAND[0]).all()
    assert not floor.holds(below, BAND[0]).any()
