"""The gate's numbers, told once more by hand: a permit, a timeout or a memory that is ten times too generous turns a test red.

Other tests compare with the module's own constants; these do not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ambler.safety.gate as gate_module
from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.safety.approach_permit import ApproachField, ApproachPermit, refusal
from ambler.safety.stuck_scan import StuckScan
from tests.safety.invariants import DOCK, LIMITS, SECOND, Bench, cluster, wall_ahead
from tests.safety.test_gaps import AHEAD, Rig

GOOD = ApproachPermit(SE2(), DOCK, 0.04, 19 * SECOND // 10)
HERE = SE2(-1.0, 0.0, 0.0)


def test_what_a_permit_may_ask_for() -> None:
    long = np.array([[0.1, -1.05], [0.4, -1.05], [0.4, 1.05], [0.1, 1.05]])
    large = np.array([[0.1, -0.65], [1.4, -0.65], [1.4, 0.65], [0.1, 0.65]])
    assert refusal(GOOD, HERE, 0) is None
    assert refusal(GOOD, SE2(-1.95, 0.0, 0.0), 0) is None
    for bad in (
        replace(GOOD, expires_ns=21 * SECOND // 10),
        replace(GOOD, outline=long),
        replace(GOOD, outline=large),
        replace(GOOD, overrun=0.06),
    ):
        assert refusal(bad, HERE, 0) is not None
    assert refusal(GOOD, SE2(-2.1, 0.0, 0.0), 0) is not None


def permitted(here: SE2 = HERE) -> ApproachField:
    field = ApproachField(LIMITS, 0.2)
    assert field.permit(GOOD, here, 0)[0]
    return field


def test_where_a_permit_holds() -> None:
    assert permitted().is_valid(SE2(-0.65, 0.0, 0.0), 0)
    assert not permitted().is_valid(SE2(-0.55, 0.0, 0.0), 0), "45 cm further"
    assert permitted().is_valid(SE2(-1.0, 0.24, 0.19), 0)
    assert not permitted().is_valid(SE2(-1.0, 0.26, 0.0), 0), "26 cm beside the line, 1 m before the dock"
    assert not permitted().is_valid(SE2(-1.0, 0.0, 0.21), 0)
    docked = permitted(SE2(-0.1, 0.0, 0.0))
    assert docked.is_valid(SE2(0.0, 0.04, 0.0), 0)
    assert not docked.is_valid(SE2(0.0, 0.06, 0.0), 0)


def test_what_a_permit_lets_pass() -> None:
    points_dock = np.array([[0.425, 0.0], [0.415, 0.0]])  # 2.5 and 3.5 cm before the outline
    assert len(permitted().remaining(HERE.inverse().transform(points_dock), HERE, 0)) == 1
    fast = permitted().limited(BodyVelocity(0.8), HERE, 0)
    assert fast.vx == pytest.approx(0.3)
    assert permitted().limited(BodyVelocity(0.0, 0.0, 1.5), HERE, 0).wz <= 0.5


def test_how_a_permit_is_renewed() -> None:
    field = permitted()
    moved = replace(GOOD, odom_from_dock=SE2(0.09, 0.0, 0.09), expires_ns=2 * SECOND)
    assert field.permit(moved, HERE, SECOND)[0]
    assert not field.permit(replace(moved, odom_from_dock=SE2(0.11, 0.0, 0.0)), HERE, SECOND)[0]
    field = permitted()
    for second in range(1, 60):
        assert field.permit(replace(GOOD, expires_ns=(second + 2) * SECOND), HERE, second * SECOND)[0]
    assert not field.permit(replace(GOOD, expires_ns=63 * SECOND), HERE, 61 * SECOND)[0]


def ticks_until(bench: Bench, state: GateState, ask: tuple[float, float, float] | None = (0.3, 0.0, 0.0)) -> float:
    """Return the seconds until the gate is in this state."""
    for tick in range(1, 400):
        if bench.tick(1, ask).state == state:
            return tick * 0.02
    raise AssertionError(f"never {state}")


def test_how_long_a_silence_is_borne_and_how_long_it_is_distrusted() -> None:
    bench = Bench(gate_module)
    bench.tick(20, (0.3, 0.0, 0.0))
    bench.has_points = False
    assert ticks_until(bench, GateState.FAULT) == pytest.approx(0.5, abs=0.03)
    bench.has_points = True
    assert ticks_until(bench, GateState.ARMED) == pytest.approx(0.5, abs=0.03)
    bench.has_odometry = False
    assert ticks_until(bench, GateState.FAULT) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize(("source", "timeout"), [("teleop", 0.4), ("docking", 0.3), ("navigation", 0.3)])
def test_how_long_a_request_counts(source: str, timeout: float) -> None:
    bench = Bench(gate_module)
    bench.tick(60, (0.3, 0.0, 0.0), source)
    seconds = 0.0
    while bench.tick(1).source:
        seconds += 0.02
    assert seconds == pytest.approx(timeout, abs=0.021)


def test_how_long_the_gate_may_sleep_and_how_far_a_clock_may_be_ahead() -> None:
    bench = Bench(gate_module)
    bench.tick(20, (0.3, 0.0, 0.0))
    bench.now_ns += 200_000_000
    assert bench.tick(1, (0.3, 0.0, 0.0)).state == GateState.ARMED
    bench.now_ns += 260_000_000
    assert bench.tick(1, (0.3, 0.0, 0.0)).reason.startswith("GATE_STARVED")
    for ahead, state in ((0.09, GateState.ARMED), (0.12, GateState.FAULT)):
        bench = Bench(gate_module)
        bench.ask(0.3, age=-ahead)
        assert bench.tick(1).state == state


def test_how_a_robot_comes_to_rest_before_a_wall_and_goes_on() -> None:
    bench = Bench(gate_module)
    wall = wall_ahead(2.0)
    for _ in range(400):
        bench.points = wall - [bench.pose.x, 0.0]
        last = bench.tick(1, (0.8, 0.0, 0.0))
    assert last.state == GateState.PROTECTIVE_STOP
    gap = 2.0 - 0.4 - bench.pose.x
    assert 0.03 <= gap < 0.06, "3 cm, and what a tenth of the speed is worth"
    bench.points = np.array([[50.0, 0.0]])
    assert ticks_until(bench, GateState.ARMED, (0.8, 0.0, 0.0)) == pytest.approx(2.0, abs=0.03)


def test_when_a_blocked_way_is_clear_again() -> None:
    """Three tenths of the wanted speed are enough, two are not."""
    for share, is_clear in ((0.35, True), (0.25, False)):
        bench = Bench(gate_module)
        bench.points = cluster(0.42, 0.0)
        ticks_until(bench, GateState.PROTECTIVE_STOP, (0.8, 0.0, 0.0))
        way = share * 0.8 * 0.2 + (share * 0.8) ** 2 / (2.0 * LIMITS.ax_brake)
        bench.points = cluster(0.43 + way, 0.0)
        states = {bench.tick(1, (0.8, 0.0, 0.0)).state for _ in range(150)}
        assert (GateState.ARMED in states) == is_clear


def test_two_points_that_agree_are_an_obstacle_and_one_is_noise() -> None:
    for count, state in ((1, GateState.ARMED), (2, GateState.PROTECTIVE_STOP)):
        bench = Bench(gate_module)
        bench.points = cluster(0.42, 0.0)[:count]
        assert bench.tick(10, (0.5, 0.0, 0.0)).state == state


def test_what_lies_4_cm_inside_is_an_obstacle_and_6_cm_inside_the_robot() -> None:
    for depth, state in ((0.04, GateState.PROTECTIVE_STOP), (0.06, GateState.ARMED)):
        bench = Bench(gate_module)
        bench.points = cluster(0.4 - depth, 0.0)
        assert bench.tick(10, (0.5, 0.0, 0.0)).state == state


def test_a_long_step_does_not_jerk() -> None:
    bench = Bench(gate_module)
    bench.tick(1, (0.8, 0.0, 0.0))
    bench.now_ns += 200_000_000
    assert bench.tick(1, (0.8, 0.0, 0.0)).velocity.vx <= LIMITS.ax_max * (0.02 + 0.05) + 1e-9


@pytest.mark.parametrize(("swings", "is_known"), [(16, True), (60, True), (600, False)])
def test_what_a_sector_scanner_saw_is_kept_for_metres(swings: int, is_known: bool) -> None:
    """Turning to and fro before a pole behind it moves a robot's corners by 0.27 m at each swing, of which a tenth counts: it remembers for 12 m."""
    rig = Rig(AHEAD[0])
    rig.turn_away()
    for k in range(swings):
        rig.pose = SE2(0.0, 0.0, np.pi + (0.3 if k % 2 else -0.3))
        rig.tick(0.0)
    rig.pose = SE2(0.0, 0.0, np.pi)
    assert (rig.backwards(3.0).vx == 0.0) == is_known


def test_a_scanner_that_repeats_itself_is_noticed_within_centimetres() -> None:
    values = np.full(100, 3.0, np.float32)
    for pose, is_stuck in ((SE2(0.015), False), (SE2(0.03), True), (SE2(0.0, 0.0, 0.03), True)):
        watch = StuckScan()
        assert not watch.update(values, SE2())
        assert watch.update(values.copy(), pose) == is_stuck
