"""What the gate does not believe: odometry that is no number or from the future; and how far it looks, and where."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import GateState, Odometry
from ambler.core.robot import SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.nodes.gate import GateNode
from ambler.robots.catalog import robot_model, robot_names
from ambler.safety.config import GateConfig, VelocitySource
from ambler.safety.field_of_view import overlap
from tests.safety.test_gaps import AHEAD, PUCK, Rig

STILL = np.zeros((6, 6))


def tell(rig: Rig, stamp_ns: int, linear: tuple[float, float, float], pose: SE3 | None = None) -> None:
    """Give the gate odometry."""
    told = Odometry(stamp_ns, "odom", "base", pose or SE3(), linear, (0.0, 0.0, 0.0), STILL, STILL)
    rig.context.callbacks["odometry"](told)


@pytest.mark.parametrize("sensor", [AHEAD[0], PUCK])
@pytest.mark.parametrize(
    ("linear", "pose"),
    [
        ((math.nan, 0.0, 0.0), SE3()),
        ((0.0, math.inf, 0.0), SE3()),
        ((0.0, 0.0, 0.0), SE3((0.0, 0.0, math.nan))),
        ((0.0, 0.0, 0.0), SE3((0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 0.0))),
    ],
)
def test_odometry_that_is_no_number_stops_the_robot(
    sensor: SensorMount, linear: tuple[float, float, float], pose: SE3
) -> None:
    """Whatever part of it: points that are carried by it would be nowhere, and the way free."""
    rig = Rig(sensor)
    for _ in range(50):
        rig.tick(-0.2)
    tell(rig, rig.context.now_ns, linear, pose)
    command = rig.tick(-0.2)
    assert (command.vx, command.vy, command.wz) == (0.0, 0.0, 0.0)
    status = rig.context.last["gate_status"]
    assert status.state is GateState.FAULT
    assert status.reason.startswith("NOT_FINITE")


def test_one_pose_from_the_future_does_not_lock_the_gate() -> None:
    """It stands for a moment, and goes on."""
    rig = Rig(AHEAD[0])
    for _ in range(50):
        rig.tick(-0.2)
    tell(rig, rig.context.now_ns + 1000 * 10**9, (0.0, 0.0, 0.0))
    for _ in range(50):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)


def test_a_pose_from_the_future_before_the_first_step_is_replaced() -> None:
    rig = Rig(AHEAD[0])
    tell(rig, 1000 * 10**9, (0.0, 0.0, 0.0))
    for _ in range(100):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)


@pytest.mark.parametrize("speed", [2.5, 3.5])
def test_clouds_are_looked_at_as_far_as_the_robot_needs_to_stand(speed: float) -> None:
    """From its sensor, wherever that stands on it."""
    model = robot_model("spot")
    fast = replace(model, limits=replace(VelocityLimits(), vx_max=speed, ax_brake=1.5))
    node = GateNode(fast)
    assert node._reach >= 2.0 * model.circumscribed_radius + 0.2 * speed + speed**2 / 3.0
    for name in robot_names():
        known = robot_model(name)
        assert GateNode(known)._reach == pytest.approx(known.circumscribed_radius + 3.0), name


@pytest.mark.parametrize(
    ("sector", "window", "both"),
    [
        ((-180, 180), (-115, 115), (-115, 115)),
        ((0, 360), (-115, 115), (-115, 115)),
        ((-180, 180), (240, 480), (240, 480)),
        ((-135, 135), (-90, 90), (-90, 90)),
        ((-135, 135), (270, 450), (-90, 90)),
        ((-90, 90), (45, 200), (45, 90)),
        ((-90, 90), (-180, 180), (-90, 90)),
        ((225, 315), (-135, 0), (225, 315)),
    ],
)
def test_what_a_mount_lets_through_of_a_scan_is_told_in_any_turn(
    sector: tuple[int, int], window: tuple[int, int], both: tuple[int, int]
) -> None:
    found = overlap(tuple(np.radians(sector)), tuple(np.radians(window)))
    assert np.degrees(found) == pytest.approx(both)


def test_arcs_that_have_nothing_in_common_leave_nothing() -> None:
    low, high = overlap((0.0, 1.0), (2.0, 3.0))
    assert low == high


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("margin", -0.5),
        ("reaction_time", -3.0),
        ("reaction_time", 0.0),
        ("points_timeout", 0.0),
        ("min_points", 0),
        ("min_points", 1000),
        ("stop_scale", 0.5),
        ("resume_scale", 1.5),
    ],
)
def test_numbers_that_would_switch_protection_off_are_refused(name: str, value: float) -> None:
    with pytest.raises(BadInputError, match=name):
        replace(GateConfig(), **{name: value})


@pytest.mark.parametrize(
    "sources",
    [(), (VelocitySource("teleop", 1, 0.3), VelocitySource("teleop", 2, 0.3)), (VelocitySource("teleop", 1, 0.0),)],
)
def test_nobody_one_twice_or_without_time_may_not_drive(sources: tuple[VelocitySource, ...]) -> None:
    with pytest.raises(BadInputError, match=r"gate\.sources"):
        GateConfig(sources=sources)
