"""How long a program waits for the robot to find out where it is, whatever the clock says when it begins, and what it does meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from ambler.core.se2 import SE2
from ambler.nodes.operator import OperatorConfig, OperatorNode
from ambler.nodes.steps import NavigateStep, ProgramEnd
from ambler.runtime.clock import SystemClock
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    ARM,
    END_PROGRAM,
    NAVIGATE,
    RECOVER,
    EndProgramRequest,
    GateReply,
    Nothing,
    RecoveryKind,
)
from ambler.runtime.topics import LOCALIZED_POSE


class Lost(Node):
    """Arms, and never says where the robot is."""

    name = "lost"
    outputs = (LOCALIZED_POSE,)
    serves = (ARM, NAVIGATE, RECOVER)

    def start(self) -> None:
        self.ctx.serve(ARM, lambda _: GateReply(True, ""))
        for task in (NAVIGATE, RECOVER):
            self.ctx.serve_task(task, lambda _: None, lambda handle: handle.cancelled())


@pytest.mark.parametrize("is_from_zero", [True, False])
def test_it_waits_as_long_as_it_says(is_from_zero: bool) -> None:
    """Also by the clock of a real robot, which tells the time of day."""
    config, ends, waited = OperatorConfig(patience=1.5), [], []
    clock = SystemClock(from_zero=is_from_zero)
    begun_ns = clock.now_ns

    def over(end: ProgramEnd) -> None:
        ends.append(end)
        waited.append((clock.now_ns - begun_ns) * 1e-9)
        executor.stop()

    executor = LiveExecutor(Stack([Lost(), OperatorNode((NavigateStep(SE2(1.0, 0.0)),), config, over)]), clock=clock)
    try:
        executor.run(20.0)
    finally:
        executor.close()
    assert [end.code for end in ends] == ["NOT_LOCALIZED"]
    assert "--may-turn" in ends[0].text, "it has not turned"
    assert waited[0] > 1.5


class Cramped(Node):
    """Has room to turn once it has gone elsewhere; does not know where it is."""

    name = "cramped"
    outputs = (LOCALIZED_POSE,)
    serves = (ARM, NAVIGATE, RECOVER)

    def __init__(self) -> None:
        self.told: list[tuple[RecoveryKind, float]] = []

    def start(self) -> None:
        self.ctx.serve(ARM, lambda _: GateReply(True, ""))
        self.ctx.serve_task(NAVIGATE, lambda _: None, lambda handle: handle.cancelled())
        self.ctx.serve_task(RECOVER, self._recover, lambda handle: handle.cancelled())

    def _recover(self, handle: Any) -> None:
        self.told.append((handle.goal.kind, handle.goal.amount))
        if [kind for kind, _ in self.told] == [RecoveryKind.ROTATE]:
            handle.fail("COLLISION_AHEAD", "there is no room to turn in place")
        else:
            handle.succeed(Nothing())


def test_who_is_lost_and_cannot_turn_goes_where_it_can_and_turns_there() -> None:
    cramped, config = Cramped(), OperatorConfig(may_turn=True, patience=3.0)
    executor = LockstepExecutor(Stack([cramped, OperatorNode((NavigateStep(SE2(1.0, 0.0)),), config, lambda _: None)]))
    executor.run(3.0)
    assert cramped.told[:3] == [
        (RecoveryKind.ROTATE, config.turn),
        (RecoveryKind.MAKE_ROOM, config.room),
        (RecoveryKind.ROTATE, config.turn),
    ]
    assert all(kind is RecoveryKind.ROTATE for kind, _ in cramped.told[3:])


class Leaving(Cramped):
    """Is on its way to where it has room."""

    name = "leaving"

    def __init__(self) -> None:
        super().__init__()
        self.cancelled = 0

    def start(self) -> None:
        self.ctx.serve(ARM, lambda _: GateReply(True, ""))
        self.ctx.serve_task(NAVIGATE, lambda _: None, lambda handle: handle.cancelled())
        self.ctx.serve_task(RECOVER, self._recover, self._cancel)

    def _recover(self, handle: Any) -> None:
        if handle.goal.kind is RecoveryKind.ROTATE:
            handle.fail("COLLISION_AHEAD", "there is no room to turn in place")

    def _cancel(self, handle: Any) -> None:
        self.cancelled += 1
        handle.cancelled()


def test_the_end_of_a_program_stops_who_is_on_the_way_to_where_it_has_room() -> None:
    leaving, config = Leaving(), OperatorConfig(may_turn=True)
    operator = OperatorNode((NavigateStep(SE2(1.0, 0.0)),), config, lambda _: None)
    executor = LockstepExecutor(Stack([leaving, operator]))
    executor.run(2.0)
    assert leaving.cancelled == 0
    executor.call(END_PROGRAM, EndProgramRequest("STOPPED", "enough"))
    executor.run(1.0)
    assert leaving.cancelled == 1
