"""Does what a person would do with a simulated robot: arms it, waits until it knows where it is, sends it to one thing after the other,
has the map finished and saved.

It exists only where nobody is at hand: in simulation and on the command line. A real robot starts paused, and a person arms it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ambler.control.recovery_motion import ROOM
from ambler.core.messages import Odometry, Status
from ambler.core.se2 import SE2
from ambler.nodes.steps import (
    DockStep,
    ExploreStep,
    NavigateStep,
    ProgramEnd,
    Step,
    StepEnd,
    TaskStep,
    TeachStep,
    UndockStep,
    name_of,
)
from ambler.runtime.node import GoalTicket, Node, Offers, Service, Task, TaskOutcome
from ambler.runtime.tasks import (
    ARM,
    DOCK,
    END_PROGRAM,
    EXPLORE,
    FINISH_MAP,
    NAVIGATE,
    RECOVER,
    SAVE_MAP,
    TEACH_DOCK,
    UNDOCK,
    DockFeedback,
    DockGoal,
    EndProgramRequest,
    ExploreFeedback,
    ExploreGoal,
    GateReply,
    GateRequest,
    NavigateFeedback,
    NavigateGoal,
    Nothing,
    RecoverGoal,
    RecoveryKind,
    SaveMapRequest,
    TeachDockGoal,
    UndockGoal,
)
from ambler.runtime.topics import LOCALIZED_POSE, STATUS

FRESH_NS = 500_000_000
Progress = Callable[[int, str], None]


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """`map_stem`: where a made map is saved (None: in a known map, which is localized in first), `saves_with` what else is, beside it. While it
    is lost a robot stands, or turns in place by `turn` radians each time when it `may_turn`, and goes at most `room` metres ahead or back where it has no
    room for that; after `patience` seconds it gives up."""

    map_stem: str | None = None
    saves_with: tuple[Service[SaveMapRequest, Nothing], ...] = ()
    settle_time: float = 1.0
    may_turn: bool = False
    turn: float = ROOM
    room: float = 1.0
    patience: float = 60.0


class OperatorNode(Node):
    """Carries out `steps` in turn and calls `on_finished` with what came of them. A drive that fails is noted and the next step follows,
    any other failure ends the program. `end_program` ends it from outside: the map so far is saved first."""

    name = "operator"
    outputs = (STATUS,)
    latency = 0.001

    def __init__(
        self,
        steps: tuple[Step, ...],
        config: OperatorConfig,
        on_finished: Callable[[ProgramEnd], None],
        on_progress: Progress | None = None,
    ) -> None:
        self._steps = steps
        self._config = config
        self._on_finished = on_finished
        self._on_progress = on_progress
        self._makes_map = config.map_stem is not None
        self.inputs = () if self._makes_map else (LOCALIZED_POSE,)
        self.serves: Offers = (END_PROGRAM,)
        self.calls = self._offers()
        self._ends: list[StepEnd] = []
        self._states: list[tuple[int, str]] = []
        self._pose: Odometry | None = None
        self._where: SE2 | None = None
        self._begun_ns = 0
        self._ticket: GoalTicket | None = None
        self._looking: GoalTicket | None = None
        self._is_saved = False
        self._is_over = False

    def start(self) -> None:
        """Begin after the sensors have settled."""
        if not self._makes_map:
            self.ctx.subscribe(LOCALIZED_POSE, self._on_pose)
        self.ctx.serve(END_PROGRAM, self._on_end_program)
        self.ctx.after(self._config.settle_time, self._arm)

    def _offers(self) -> Offers:
        wanted: dict[type[Any], Service[Any, Any] | Task[Any, Any, Any]] = {
            ExploreStep: EXPLORE,
            NavigateStep: NAVIGATE,
            DockStep: DOCK,
            UndockStep: UNDOCK,
            TeachStep: TEACH_DOCK,
        }
        named = (step.task if isinstance(step, TaskStep) else wanted[type(step)] for step in self._steps)
        steps = tuple(dict.fromkeys(named))
        saving: Offers = (FINISH_MAP, *self._config.saves_with, SAVE_MAP) if self._makes_map else (RECOVER,)
        return (ARM, *steps, *saving)

    # Before the first step

    def _on_pose(self, pose: Odometry) -> None:
        self._pose = pose

    def _arm(self) -> None:
        if not self._is_over:
            self.ctx.call(ARM, GateRequest(self.name, "a program begins"), self._armed)

    def _armed(self, reply: GateReply | Exception) -> None:
        if isinstance(reply, Exception) or not reply.is_done:
            text = str(reply) if isinstance(reply, Exception) else reply.text
            self._say("NOT_ARMED", f"the gate refused to arm: {text}")
            self.ctx.after(self._config.settle_time, self._arm)
        elif self._makes_map:
            self._next()
        else:
            self._begun_ns = self.ctx.now_ns
            self._wait_for_pose()

    def _wait_for_pose(self) -> None:
        """Go on once the pose is known; meanwhile turn, if that is permitted, so that localization sees another view, and go to where there is room for that."""
        pose, config = self._pose, self._config
        if self._is_over:
            return
        if pose is not None and self.ctx.now_ns - pose.stamp_ns < FRESH_NS:
            self._where = pose.pose.to_se2()
            x, y, yaw = self._where.as_array()
            self._say("LOCALIZED", f"the robot stands at {x:.2f}, {y:.2f} m, {yaw:.2f} rad in the map")
            self._next()
        elif self.ctx.now_ns - self._begun_ns > config.patience * 1e9:
            advice = "" if config.may_turn else "; let it turn (--may-turn), or tell it its pose"
            text = f"the robot did not find out within {config.patience:g} s where it is{advice}"
            self._finish("NOT_LOCALIZED", text)
        elif config.may_turn:
            turn = RecoverGoal(RecoveryKind.ROTATE, config.turn)
            self._looking = self.ctx.send_goal(RECOVER, turn, self._turned)
        else:
            self._look_again()

    def _turned(self, outcome: TaskOutcome[Any]) -> None:
        if outcome.code == "COLLISION_AHEAD" and not self._is_over:
            go = RecoverGoal(RecoveryKind.MAKE_ROOM, self._config.room)
            self._looking = self.ctx.send_goal(RECOVER, go, lambda _: self._look_again())
        else:
            self._look_again()

    def _look_again(self) -> None:
        self._looking = None
        self.ctx.after(0.5, self._wait_for_pose)

    # Steps

    def _next(self) -> None:
        failed = next((e for e in self._ends if not e.is_success and not isinstance(e.step, NavigateStep)), None)
        if failed is not None or len(self._ends) == len(self._steps):
            self._conclude()
            return
        step, self._begun_ns = self._steps[len(self._ends)], self.ctx.now_ns
        self._say(f"STEP_{name_of(step).upper()}", f"step {len(self._ends) + 1} of {len(self._steps)}")
        match step:
            case ExploreStep():
                self._ticket = self.ctx.send_goal(EXPLORE, ExploreGoal(), self._explored, self._tell_exploration)
            case NavigateStep():
                goal = NavigateGoal(step.map_from_goal, step.xy_tolerance, step.yaw_tolerance, step.level)
                self._ticket = self.ctx.send_goal(NAVIGATE, goal, self._ended, self._tell_drive)
            case DockStep():
                self._ticket = self.ctx.send_goal(DOCK, DockGoal(step.dock), self._ended, self._tell_docking)
            case UndockStep():
                self._ticket = self.ctx.send_goal(UNDOCK, UndockGoal(step.dock), self._ended, self._tell_docking)
            case TaskStep():
                self._ticket = self.ctx.send_goal(step.task, step.goal, self._ended, self._tell_task)
            case TeachStep():
                self._ticket = self.ctx.send_goal(TEACH_DOCK, TeachDockGoal(step.dock), self._ended, self._tell_docking)

    def _explored(self, outcome: TaskOutcome[Any]) -> None:
        """An exploration is over when its map is saved, so that later steps lose nothing."""
        if not self._is_over:
            self._note(
                outcome.code,
                outcome.text,
                outcome.result,
            )
            self._save(self._next)

    def _ended(self, outcome: TaskOutcome[Any]) -> None:
        if not self._is_over:
            self._is_saved = False
            self._note(outcome.code, outcome.text, outcome.result)
            self._next()

    def _note(self, code: str, text: str, result: Any) -> None:
        self._ticket = None
        step = self._steps[len(self._ends)]
        self._ends.append(StepEnd(step, code, text, result, self._begun_ns, self.ctx.now_ns))
        self._say(code, text or f"step {len(self._ends)} is done")

    # The end

    def _conclude(self) -> None:
        failed = next((end for end in self._ends if not end.is_success), None)
        code, text = ("SUCCEEDED", "") if failed is None else (failed.code, failed.text)
        if self._is_saved or not self._makes_map:
            self._finish(code, text)
        else:
            self._save(lambda: self._finish(code, text))

    def _save(self, then: Callable[[], None], *, finishes: bool = True) -> None:
        """Have the map finished (unless there is no time) and saved, then go on; a map that cannot be saved ends the program."""
        if finishes:
            self.ctx.send_goal(FINISH_MAP, Nothing(), lambda _: self._save(then, finishes=False))
            return
        request = SaveMapRequest(str(self._config.map_stem))
        left, troubles = [SAVE_MAP, *self._config.saves_with], list[str]()

        def save_next(reply: Nothing | Exception) -> None:
            if isinstance(reply, Exception):
                troubles.append(str(reply))
            if left:  # whatever failed before: one that cannot be saved takes no other with it
                self.ctx.call(left.pop(0), request, save_next)
            elif troubles:
                self._finish("MAP_NOT_SAVED", "; ".join(troubles))
            else:
                self._is_saved = True
                then()

        save_next(Nothing())

    def _on_end_program(self, request: EndProgramRequest) -> Nothing:
        """End whatever is under way; the map so far is saved as it is."""
        if self._is_over:
            return Nothing()
        ticket, self._is_over = self._ticket, True
        if self._looking is not None:
            self._looking.cancel()
        if ticket is not None:
            self._note(request.code, request.text, None)
        if ticket is not None:
            ticket.cancel()
        if self._makes_map:
            self._save(lambda: self._finish(request.code, request.text), finishes=False)
        else:
            self._finish(request.code, request.text)
        return Nothing()

    def _finish(self, code: str, text: str) -> None:
        self._is_over = True
        self._say(code, text or "all is done")
        self._on_finished(ProgramEnd(code, text, tuple(self._ends), tuple(self._states), self._where))

    # Telling

    def _tell_exploration(self, feedback: ExploreFeedback) -> None:
        state = feedback.state.lower()
        if feedback.state == "SCANNING":
            state = f"scanning station {feedback.stations + 1}"
        self._show(
            f"{state:<9}  {feedback.known_area:6.1f} m² known  {feedback.frontiers_open:2d} frontiers open  "
            f"{feedback.goals_reached:3d} goals"
        )

    def _tell_drive(self, feedback: NavigateFeedback) -> None:
        state = feedback.state.lower().replace("_", " ")
        self._show(f"{state:<9}  {feedback.distance_remaining:6.1f} m to go  {feedback.recoveries:2d} recoveries")

    def _tell_docking(self, feedback: DockFeedback) -> None:
        if not self._states or self._states[-1][1] != feedback.state:
            self._states.append((self.ctx.now_ns, feedback.state))
        away = "dock not seen" if feedback.distance is None else f"{feedback.distance:6.3f} m to the docked pose"
        self._show(f"{feedback.state:<9}  {away}  {feedback.attempts:2d} failed approaches")

    def _tell_task(self, feedback: Any) -> None:
        self._show(str(feedback))

    def _show(self, text: str) -> None:
        if self._on_progress is not None:
            self._on_progress(self.ctx.now_ns, f"step {len(self._ends) + 1} of {len(self._steps)}: {text}")

    def _say(self, code: str, text: str) -> None:
        self.ctx.log(code, text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text))
