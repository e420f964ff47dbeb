"""Gate, controller and navigator together on the bus, in lockstep with a toy robot."""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from ambler.control.config import RolloutConfig
from ambler.control.motion_primitives import MotionPrimitives
from ambler.control.primitives_config import PrimitivesConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.control.unseen_ground import UnseenGroundConfig
from ambler.core.errors import NoValidControlError, NoValidPathError
from ambler.core.grid import OCC_ASSUMED, GridSpec
from ambler.core.messages import GateState, OccupancyGrid, PointCloud, PoseStamped, VelocityCommand
from ambler.core.movers import NOBODY, Movers
from ambler.core.protocols import BodyVelocity, LocalPlanner
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.nodes.controller import ControllerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.local_view import LocalView
from ambler.nodes.navigator import NavigatorNode
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    ARM,
    EMERGENCY_STOP,
    FOLLOW_PATH,
    NAVIGATE,
    PAUSE,
    RECOVER,
    RESET_STOP,
    FollowPathGoal,
    GateRequest,
    NavigateGoal,
    RecoverGoal,
    RecoveryKind,
)
from ambler.runtime.topics import (
    GOAL,
    MAP,
    MOVERS,
    SCAN,
    STATUS,
    STEER_REQUEST,
    TELEOP_REQUEST,
    VELOCITY_REQUEST,
    Topic,
)
from tests.control.toy_robot import MAP_FROM_ODOM, ROBOT, Person, ToyBase, ToyPlanner, room, straight_path

Act = Callable[[Person], None]
STILL = BodyVelocity()
OPEN = room(-6.0, -6.0, 6.0, 6.0)


def goal_at(x: float, y: float = 0.0, yaw: float = 0.0) -> SE2:
    """A goal told in the odom frame, as a pose of the map."""
    return MAP_FROM_ODOM @ SE2(x, y, yaw)


def follow(x: float, y: float = 0.0) -> Act:
    return lambda p: p.send(FOLLOW_PATH, FollowPathGoal(straight_path(SE2(), goal_at(x, y))))


def navigate(x: float, y: float = 0.0) -> Act:
    return lambda p: p.send(NAVIGATE, NavigateGoal(goal_at(x, y)))


def ask(service: object) -> Act:
    return lambda p: p.ask(service, GateRequest("person", "test"))


def cancel(p: Person) -> None:
    p.ticket.cancel()


class Mapper(Node):
    """Tells a map once."""

    name = "mapper"
    outputs = (MAP,)

    def __init__(self, ground: OccupancyGrid) -> None:
        self._ground = ground

    def start(self) -> None:
        self.ctx.publish(MAP, self._ground)


class Robot:
    """A running stack."""

    def __init__(
        self,
        script: list[tuple[float, Act]],
        walls: np.ndarray = OPEN,
        *,
        is_armed: bool = True,
        local: LocalPlanner | None = None,
        ground: OccupancyGrid | None = None,
    ) -> None:
        self.base = ToyBase(walls)
        self.planner = ToyPlanner(self.base)
        self.person = Person([(0.3, ask(ARM)), *script] if is_armed else script)
        self.gate = GateNode(ROBOT)
        local = TrajectoryRollout(RolloutConfig(), ROBOT) if local is None else local
        unseen = None if ground is None else UnseenGroundConfig(speed=0.2)
        self.controller = ControllerNode(ROBOT, local, LocalCostmap(LocalCostmapConfig(), ROBOT), unseen=unseen)
        nodes = [self.base, self.planner, self.controller, NavigatorNode(), self.gate, self.person]
        nodes += [] if ground is None else [Mapper(ground)]
        self.executor = LockstepExecutor(Stack(nodes, external=(TELEOP_REQUEST,)), on_failure=self.gate.stop_now)
        self.told: list[tuple[float, str, str]] = []
        self.executor.tap(self._hear)

    def _hear(self, topic: Topic[Any], message: Any, now_ns: int, writer: str) -> None:
        if topic is STATUS and writer == "controller":
            self.told.append((now_ns * 1e-9, message.code, message.text))

    def run(self, seconds: float) -> "Robot":
        self.executor.run(seconds)
        return self

    @property
    def codes(self) -> list[str]:
        return [o.code for o in self.person.outcomes]

    def commands_after(self, seconds: float) -> list[BodyVelocity]:
        return [v for ns, v in self.base.heard if ns > seconds * 1e9]


def test_follow_path_reaches_its_end_and_leaves_zero() -> None:
    robot = Robot([(0.5, follow(1.5))]).run(6.0)
    assert robot.codes == ["SUCCEEDED"]
    assert robot.base.pose.distance_to(SE2(1.5, 0.0, 0.0)) < 0.15
    assert robot.commands_after(5.5)[-1] == STILL


def test_onto_ground_that_is_only_assumed_it_drives_slowly_and_on_seen_ground_it_does_not() -> None:
    """The map assumes a strip from 1.5 to 2.0 m ahead, in its own frame."""
    spec = GridSpec(0.1, 200, 200, -10.0, -10.0)
    cells = spec.centers_of(np.stack(np.divmod(np.arange(200 * 200), 200), axis=1))
    ahead = MAP_FROM_ODOM.inverse().transform(cells)[:, 0].reshape(200, 200)
    data = np.where((ahead > 1.5) & (ahead < 2.0), OCC_ASSUMED, 0).astype(np.int8)
    robot = Robot([(0.5, follow(4.0))], ground=OccupancyGrid(0, "map", spec, data))
    fastest: dict[bool, float] = {True: 0.0, False: 0.0}
    while robot.executor.now_ns < 20e9 and not robot.codes:
        robot.run(0.1)
        x, v = robot.base.pose.x, robot.base.heard[-1][1].vx if robot.base.heard else 0.0
        fastest[0.9 < x < 1.9] = max(fastest[0.9 < x < 1.9], v)
    assert robot.codes == ["SUCCEEDED"]
    assert fastest[True] <= 0.2 + 1e-6
    assert fastest[False] > 0.4


def test_nothing_moves_before_the_gate_is_armed() -> None:
    robot = Robot([(0.5, follow(1.5))], is_armed=False).run(13.0)
    assert robot.base.pose == SE2()
    assert robot.codes == [], "a paused gate is no lack of progress"
    assert {s.state for s in robot.person.states} == {GateState.PAUSED}


def test_a_robot_creeps_towards_who_stands_in_its_way_and_that_is_no_lack_of_progress(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Robot([(0.6, follow(3.0))])
    stands = Movers(0, np.array([[1.5, 0.1, 0.0, 0.0, 0.0, 0.0]]))
    monkeypatch.setattr(robot.controller._view, "movers", lambda now_ns: stands)
    robot.run(14.0)
    assert max(math.hypot(v.vx, v.vy) for v in robot.commands_after(0.0)) < 0.05
    assert robot.base.pose.x > 0.2
    assert robot.codes == []


class Asking(TrajectoryRollout):
    """Keeps the answers to what it asks about."""

    def set_refusal(self, is_refused: Callable[[BodyVelocity], bool]) -> None:
        self.answers: list[bool] = []

        def ask_and_keep(wanted: BodyVelocity) -> bool:
            self.answers.append(is_refused(wanted))
            return self.answers[-1]

        super().set_refusal(ask_and_keep)


@pytest.mark.parametrize("is_somebody_there", [True, False])
def test_a_planner_that_asks_is_refused_what_would_start_a_contact(
    monkeypatch: pytest.MonkeyPatch, *, is_somebody_there: bool
) -> None:
    planner = Asking(RolloutConfig(), ROBOT)
    robot = Robot([(0.6, follow(3.0))], local=planner)
    if is_somebody_there:
        stands = Movers(0, np.array([[1.0, 0.1, 0.0, 0.0, 0.0, 0.0]]))
        monkeypatch.setattr(robot.controller._view, "movers", lambda now_ns: stands)
    robot.run(2.0)
    assert planner.answers, "it was asked"
    assert any(planner.answers) is is_somebody_there


def test_what_the_gate_holds_is_not_asked_for_again_where_the_robot_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the gate knows of what touches the robot's left side: straight on and to the left it may not go, to the right it may."""
    robot = Robot([(0.6, navigate(3.0))])
    field = robot.gate.gate._field

    def free_scale(velocity: BodyVelocity, points: np.ndarray) -> float:
        return 0.0 if robot.base.pose.x < 0.2 and velocity.wz > -1e-3 else 1.0

    monkeypatch.setattr(field, "free_scale", free_scale)
    robot.run(12.0)
    assert robot.base.pose.x > 0.5
    assert robot.codes == ["SUCCEEDED"]


def test_a_robot_that_finds_no_motion_is_told_to_have_wanted_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """What it wanted last is not to blame for a stop that lasts while it wants nothing."""
    robot, told = Robot([(0.6, follow(3.0))]), list[BodyVelocity]()
    robot.run(1.5)
    update = robot.controller._held_motions.update
    monkeypatch.setattr(
        robot.controller._held_motions,
        "update",
        lambda s, h, v, is_held: (told.append(v), update(s, h, v, is_held=is_held)),
    )

    def finds_none(*args: object) -> BodyVelocity:
        raise NoValidControlError("everything collides")

    monkeypatch.setattr(robot.controller._planner, "compute_command", finds_none)
    robot.run(0.5)
    assert told[0].vx > 0.1, "it was driving"
    assert set(told[2:]) == {STILL}


def test_where_people_are_is_told_until_nobody_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, told = Robot([]), list[PointCloud]()
    robot.executor.tap(lambda topic, message, *_: told.append(message) if topic is MOVERS else None)
    crowd = [NOBODY, Movers(0, np.array([[1.5, 0.1, 0.3, 0.4, 0.0, 0.0]])), NOBODY]
    monkeypatch.setattr(LocalView, "tracked", property(lambda view: crowd[0] if len(crowd) == 1 else crowd.pop(0)))
    robot.run(2.0)
    assert [len(cloud.points) for cloud in told] == [1, 0], "the empty one once"
    assert told[0].frame == "odom"
    assert np.allclose(told[0].points, [[1.5, 0.1, 0.0]])
    assert np.allclose(told[0].intensity, [0.5])


def test_cancelling_stops() -> None:
    robot = Robot([(0.5, follow(4.0)), (2.0, cancel)]).run(4.0)
    assert robot.codes == ["CANCELLED"]
    assert 0.3 < robot.base.pose.x < 2.5
    assert robot.commands_after(3.0)[-1] == STILL


def test_a_new_path_goal_preempts() -> None:
    robot = Robot([(0.5, follow(4.0)), (1.5, follow(0.8, 1.0))]).run(10.0)
    assert robot.codes == ["PREEMPTED", "SUCCEEDED"]
    assert robot.base.pose.distance_to(SE2(0.8, 1.0, 0.0)) < 0.15


@pytest.mark.parametrize("sense", ["has_scan", "has_odometry"])
def test_a_silent_sensor_ends_the_path_by_name(sense: str) -> None:
    robot = Robot([(0.5, follow(4.0)), (2.0, lambda p: None)])
    robot.person._script.append((2.0, lambda p: setattr(robot.base, sense, False)))
    robot.run(5.0)
    assert robot.codes == ["STALE_INPUT"]
    assert robot.base.velocity == STILL
    reasons = [s.reason for s in robot.person.states if s.state is GateState.FAULT]
    assert reasons
    assert all("STALE" in r for r in reasons)


def test_recoveries_on_the_bus() -> None:
    turn = RecoverGoal(RecoveryKind.ROTATE, math.pi / 2)
    back = RecoverGoal(RecoveryKind.BACK_UP, 0.3)
    robot = Robot([(0.5, lambda p: p.send(RECOVER, turn)), (5.0, lambda p: p.send(RECOVER, back))]).run(10.0)
    assert robot.codes == ["SUCCEEDED", "SUCCEEDED"]
    assert abs(robot.base.pose.yaw - math.pi / 2) < 0.1
    assert abs(robot.base.pose.y + 0.3) < 0.06


def test_room_to_turn_is_made_on_the_bus() -> None:
    """A wall 5 cm beside the tail: it cannot turn here, and goes ahead to where it can."""
    wall = np.vstack((OPEN, [[-0.9, 0.28, 0.1, 0.28]]))
    turn, go = RecoverGoal(RecoveryKind.ROTATE, 0.8), RecoverGoal(RecoveryKind.MAKE_ROOM, 1.5)
    steps = [(0.8, turn), (2.0, go), (13.0, turn)]
    robot = Robot([(t, lambda p, goal=goal: p.send(RECOVER, goal)) for t, goal in steps], wall).run(18.0)
    assert robot.codes == ["COLLISION_AHEAD", "SUCCEEDED", "SUCCEEDED"]
    assert abs(abs(robot.base.pose.yaw) - 0.8) < 0.1
    assert robot.base.pose.x > 0.1


def test_a_recovery_without_room_says_so() -> None:
    corner = np.vstack((OPEN, [[-0.28, -1.0, -0.28, 1.0]]))
    back = RecoverGoal(RecoveryKind.BACK_UP, 0.3)
    robot = Robot([(0.8, lambda p: p.send(RECOVER, back))], corner).run(2.0)
    assert robot.codes == ["COLLISION_AHEAD"]
    assert robot.base.pose.x > -0.03


def test_navigate_and_a_click_that_preempts_it() -> None:
    click = PoseStamped(0, "map", SE3.from_se2(goal_at(0.5, 1.0)))
    robot = Robot([(0.5, navigate(4.0)), (2.0, lambda p: p.ctx.publish(GOAL, click))]).run(10.0)
    assert robot.codes == ["PREEMPTED"]
    assert robot.base.pose.distance_to(SE2(0.5, 1.0, 0.0)) < 0.15
    assert robot.commands_after(9.5)[-1] == STILL


def test_navigate_fails_by_name_when_there_is_no_path() -> None:
    robot = Robot([(0.5, navigate(2.0))])
    robot.planner.failure = NoValidPathError("walled in")
    robot.run(2.0)
    assert robot.codes == ["NO_VALID_PATH"]
    assert robot.planner.cleared == 1
    assert robot.base.pose == SE2()


def test_navigate_to_a_goal_in_a_wall_ends_beside_it_and_says_how_far() -> None:
    robot = Robot([(0.5, navigate(2.5))])
    robot.planner.nearest = goal_at(1.7)
    robot.run(10.0)
    assert robot.codes == ["NEAREST_REACHED"]
    (outcome,) = robot.person.outcomes
    away = 2.5 - robot.base.pose.x
    assert 0.6 < away < 1.3
    assert outcome.result.goal_distance == pytest.approx(away, abs=0.02)
    assert f"{outcome.result.goal_distance:.2f} m" in outcome.text


def test_navigate_into_a_wall_gives_up_without_touching_it() -> None:
    wall = np.vstack((OPEN, [[1.0, -3.0, 1.0, 3.0]]))
    robot = Robot([(0.5, navigate(3.0))], wall).run(75.0)
    assert robot.codes == ["RECOVERIES_EXHAUSTED"]
    assert robot.person.outcomes[0].result.recoveries == 7
    corners = robot.base.pose.transform(ROBOT.footprint)
    assert corners[:, 0].max() < 1.0
    assert robot.base.velocity == STILL


def test_what_no_sensor_shows_is_noticed_by_standing_at_it() -> None:
    """Glass, or the end of a low kerb: told to move, let through by the gate, it does not get on, and has not pushed for much longer than two seconds."""
    robot = Robot([(0.5, follow(3.0))])
    robot.base.held_beyond = 1.0
    robot.run(20.0)
    assert robot.codes == ["HELD"]
    assert "something holds it that no sensor shows" in robot.person.outcomes[0].text
    pushing = [ns for ns, v in robot.base.heard if v.vx > 0.1]
    reached = next(ns for ns, v in robot.base.heard if v.vx > 0.1) + 1e9 * (1.0 / ROBOT.limits.vx_max)
    assert 1.0 < (pushing[-1] - reached) * 1e-9 < 2.5
    assert robot.base.velocity == STILL


def test_a_robot_that_the_gate_slows_or_that_is_held_and_let_go_is_not_stuck() -> None:
    """Along a wall at which the gate slows it, and again after an emergency stop of three seconds, it drives on."""
    wall = np.vstack((OPEN, [[0.5, 0.36, 3.2, 0.36]]))
    script = [(0.5, follow(3.0)), (1.5, ask(EMERGENCY_STOP)), (4.5, ask(RESET_STOP)), (4.6, ask(ARM))]
    robot = Robot(script, wall).run(25.0)
    assert robot.codes == ["SUCCEEDED"]


def test_a_cycle_begins_with_every_scan_and_the_gate_passes_its_request_on_at_once() -> None:
    robot = Robot([(0.5, follow(4.0))])
    scans: list[int] = []
    requests: list[int] = []
    heard = {SCAN: scans, VELOCITY_REQUEST: requests}
    robot.executor.tap(lambda topic, message, now_ns, writer: heard[topic].append(now_ns) if topic in heard else None)
    robot.run(3.0)
    begun = np.array([ns for ns in requests if ns > 1_000_000_000])
    for arrival in (ns for ns in scans if 1_000_000_000 < ns < 2_900_000_000):
        assert 0 <= (begun[begun >= arrival][0] - arrival) <= 11_000_000, "the controller's latency, and no wait"
    assert set(np.diff(begun)) <= set(range(40_000_000, 56_000_000))
    commands = np.array([ns for ns, _ in robot.base.heard])
    for asked in begun[begun < 2_900_000_000]:
        assert commands[commands > asked][0] - asked <= 1_000_000, "the gate's latency, and no wait"


def late_by(delays: Iterator[float], robot: Robot) -> tuple[list[int], list[int]]:
    """Let the robot's scans come late by the next delay (s) each. Returns when scans and requests come (ns); both grow during a run."""
    scans: list[int] = []
    requests: list[int] = []
    scan = robot.base._scan
    robot.base._scan = lambda: robot.base.ctx.after(next(delays), scan)  # type: ignore[method-assign]
    heard = {SCAN: scans, VELOCITY_REQUEST: requests}
    robot.executor.tap(lambda topic, message, now_ns, writer: heard[topic].append(now_ns) if topic in heard else None)
    return scans, requests


def test_scans_that_come_out_of_step_are_met_again() -> None:
    robot, rng = Robot([(0.5, follow(4.0))]), np.random.default_rng(3)
    scans, requests = late_by(iter(lambda: float(rng.uniform(0.0, 0.06)), None), robot)
    robot.run(4.0)
    begun = np.array(requests)
    waits = [begun[begun >= ns][0] - ns for ns in scans if 1_000_000_000 < ns < 3_900_000_000]
    assert max(waits) <= 36_000_000, "25 ms between cycles, and the controller's latency"
    assert max(waits) > 20_000_000, "some come soon after a cycle"
    assert np.diff(begun[begun > 1_000_000_000]).min() >= 25_000_000 - 1_000_000


def test_a_request_that_comes_with_a_beat_of_the_gate_is_passed_on() -> None:
    robot = Robot([(0.5, follow(4.0))])
    _, requests = late_by(itertools.repeat(0.0085), robot)  # then a request comes half a millisecond after a beat
    robot.run(3.0)
    steps = np.array([ns for ns, _ in robot.base.heard]) - 1_000_000  # the gate's latency
    asked = np.array([ns for ns in requests if 1_000_000_000 < ns < 2_900_000_000])
    before = steps[np.searchsorted(steps, asked, side="right") - 1]
    assert np.count_nonzero(asked - before < 1_000_000) > 10
    waits = steps[np.searchsorted(steps, asked)] - asked
    assert max(waits) <= 1_000_000, "a millisecond between steps"


def test_the_emergency_stop_over_the_bus() -> None:
    script = [
        (0.5, follow(4.0)),
        (2.0, ask(EMERGENCY_STOP)),
        (2.5, ask(ARM)),
        (3.0, ask(RESET_STOP)),
        (5.0, ask(PAUSE)),
    ]
    robot = Robot(script).run(6.0)
    first_zero = next(ns for ns, v in robot.base.heard if ns > 2_000_000_000 and v == STILL)
    assert first_zero - 2_000_000_000 < 30_000_000
    assert set(robot.commands_after(2.05)) == {STILL}
    assert [r.is_done for r in robot.person.replies] == [True, True, False, True, True]
    states = [s.state for s in robot.person.states]
    assert GateState.EMERGENCY_STOP in states
    assert states[-1] is GateState.PAUSED


def test_a_failed_node_stops_the_robot_for_good() -> None:
    robot = Robot([(0.5, follow(4.0)), (3.0, ask(RESET_STOP))])
    robot.person._script.append((2.0, lambda p: robot.gate.stop_now("node toy failed")))
    robot.run(4.0)
    assert set(robot.commands_after(2.05)) == {STILL}
    assert robot.person.replies[-1].is_done is False
    assert robot.person.states[-1].state is GateState.EMERGENCY_STOP


def test_the_command_has_a_heartbeat() -> None:
    robot = Robot([], is_armed=False).run(2.0)
    stamps = [ns for ns, _ in robot.base.heard]
    assert max(np.diff(stamps)) <= 20_000_000
    assert len(stamps) >= 98


# A planner that can be steered and tells its state


def steered(seconds: tuple[float, float], vx: float, vy: float = 0.0) -> list[tuple[float, Act]]:
    """A person who steers from one time to another, ten times a second."""

    def ask_for(p: Person) -> None:
        p.ctx.publish(STEER_REQUEST, VelocityCommand(p.ctx.now_ns, vx, vy, 0.0))

    return [(float(t), ask_for) for t in np.arange(*seconds, 0.1)]


def primitives() -> MotionPrimitives:
    return MotionPrimitives(PrimitivesConfig(), ROBOT)


def test_a_person_steers_through_the_planner_and_the_gate() -> None:
    walls = np.vstack((OPEN, [[1.6, -3.0, 1.6, 3.0], [-1.0, 0.5, 1.6, 0.5], [-1.0, -0.5, 1.6, -0.5]]))
    robot = Robot(steered((0.6, 8.0), 0.5), walls, local=primitives()).run(10.0)
    front = robot.base.pose.transform(ROBOT.footprint)[:, 0].max()
    assert 0.9 < front < 1.6, "it comes to the wall and stands before it"
    assert robot.commands_after(9.0)[-1] == STILL
    assert any(code == "LOCAL_BLOCKED" for _, code, _ in robot.told)
    assert {s.source for s in robot.person.states} <= {"", "navigation"}, (
        "steering has no way around the gate, nor to it"
    )


def test_a_path_waits_while_a_person_steers_and_goes_on_afterwards() -> None:
    script = [(0.5, follow(3.0)), *steered((1.5, 4.0), 0.0, 0.4)]
    robot = Robot(script, local=primitives()).run(4.0)
    assert robot.codes == []
    assert robot.base.pose.y > 0.3, "the person has it go to the left"
    robot.run(14.0)
    assert robot.codes == ["SUCCEEDED"]
    assert robot.base.pose.distance_to(SE2(3.0, 0.0, 0.0)) < 0.15


def test_letting_go_of_the_stick_stops() -> None:
    robot = Robot(steered((0.6, 2.0), 0.5), local=primitives()).run(3.5)
    assert robot.base.pose.x > 0.3
    assert robot.commands_after(2.9)[-1] == STILL
    assert robot.base.velocity == STILL


def test_a_planner_that_cannot_be_steered_says_so_and_stands() -> None:
    robot = Robot(steered((0.6, 3.0), 0.5)).run(3.0)
    assert robot.base.pose == SE2()
    assert any("cannot be steered" in text for _, _, text in robot.told)


def test_why_it_stands_is_told() -> None:
    script = [(0.5, follow(4.0)), (2.0, ask(PAUSE)), (4.0, ask(ARM))]
    robot = Robot(script, local=primitives()).run(12.0)
    codes = [code for _, code, _ in robot.told]
    assert codes[-1] in {"LOCAL_GOAL_REACHED", "LOCAL_IDLE"}
    assert "LOCAL_DRIVING" in codes
    held = [t for t, code, _ in robot.told if code == "HELD_PAUSED"]
    assert any(2.0 < t < 2.7 for t in held)
    assert all(b - a >= 0.49 for (a, *_), (b, *_) in itertools.pairwise(robot.told)), "no flood of news"
