"""What is remembered beside a robot that turns: turning to and fro brings it back to where it looked, turning on does not."""

import math

import numpy as np

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.safety.blind_memory import BlindMemory
from ambler.safety.field_of_view import FieldOfView

RADIUS, TRAVEL = 0.6, 12.0
HIGH = SE3.from_se2(SE2(), 0.9)
FIELD = FieldOfView(0.1, elevation=(math.radians(-15.0), math.radians(15.0)))
NOTHING = np.empty((0, 3))


def seat(distance: float) -> np.ndarray:
    """The edge of a seat of 0.42 m that a LiDAR at 0.9 m sees from 1.8 m on."""
    ys = np.linspace(-0.3, 0.3, 61)
    return np.stack((np.full_like(ys, distance), ys, np.full_like(ys, 0.42)), axis=1)


def remembered(turns: list[float]) -> bool:
    """Whether the seat is still known after turning in place to these headings, 0.7 m before it."""
    memory, here = BlindMemory(RADIUS, TRAVEL), SE2(1.3, 0.0, 0.0)
    for x in np.arange(0.0, 1.3, 0.02):
        pose, points = SE2(float(x), 0.0, 0.0), seat(2.0 - float(x))
        is_met = np.arctan2(0.48, np.hypot(points[:, 0], points[:, 1])) < math.radians(15.0)
        memory.update(points[is_met], pose, HIGH, FIELD)
    kept = memory.update(NOTHING, here, HIGH, FIELD)
    assert len(kept) > 5, "the seat is below the rays now"
    for yaw in turns:
        kept = memory.update(NOTHING, SE2(here.x, here.y, yaw), HIGH, FIELD)
    return len(kept) > 5


def test_turning_to_and_fro_for_a_minute_forgets_nothing() -> None:
    swing = np.concatenate((np.arange(0.0, 0.7, 0.05), np.arange(0.7, 0.0, -0.05)))
    assert remembered(np.tile(swing, 30).tolist())


def test_turning_on_forgets_in_time() -> None:
    once = [SE2(0.0, 0.0, yaw).yaw for yaw in np.arange(0.0, 2.0 * math.pi, 0.05)]
    assert remembered(once)
    assert not remembered(4 * once)
