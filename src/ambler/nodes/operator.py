"""Does what a person would do at the start and the end of an exploration: arms the simulated base, starts, saves the map.

It exists only in demonstrations: a real robot starts paused, and a person arms it.
"""

from __future__ import annotations

from collections.abc import Callable

from ambler.core.messages import Status
from ambler.runtime.node import Node, Offers, TaskOutcome
from ambler.runtime.tasks import (
    ARM,
    EXPLORE,
    FINISH_MAP,
    SAVE_GLASS,
    SAVE_MAP,
    ExploreFeedback,
    ExploreGoal,
    ExploreResult,
    GateReply,
    GateRequest,
    Nothing,
    SaveMapRequest,
)
from ambler.runtime.topics import STATUS

Outcome = TaskOutcome[ExploreResult]


class OperatorNode(Node):
    """Arms, explores, has the map finished, saves it (and, when `saves_glass`, its glass) under `map_stem`, then calls `on_finished` with the outcome of the exploration."""

    name = "operator"
    outputs = (STATUS,)
    calls: Offers = (ARM, EXPLORE, FINISH_MAP, SAVE_MAP)
    latency = 0.001

    def __init__(
        self,
        map_stem: str,
        on_finished: Callable[[Outcome], None],
        on_feedback: Callable[[int, ExploreFeedback], None] | None = None,
        settle_time: float = 1.0,
        *,
        saves_glass: bool = False,
    ) -> None:
        self._saves_glass = saves_glass
        if saves_glass:
            self.calls = (*type(self).calls, SAVE_GLASS)
        self._map_stem = map_stem
        self._on_finished = on_finished
        self._on_feedback = on_feedback
        self._settle_time = settle_time

    def start(self) -> None:
        self.ctx.after(self._settle_time, self._arm)

    def _arm(self) -> None:
        request = GateRequest("operator", "the demonstration starts")
        self.ctx.call(ARM, request, self._armed)

    def _armed(self, reply: GateReply | Exception) -> None:
        if isinstance(reply, Exception) or not reply.is_done:
            text = str(reply) if isinstance(reply, Exception) else reply.text
            self._say("NOT_ARMED", f"the gate refused to arm: {text}")
            self.ctx.after(self._settle_time, self._arm)
            return
        self._say("EXPLORING", "exploration starts")
        self.ctx.send_goal(EXPLORE, ExploreGoal(), self._explored, self._feedback)

    def _feedback(self, feedback: ExploreFeedback) -> None:
        if self._on_feedback is not None:
            self._on_feedback(self.ctx.now_ns, feedback)

    def _explored(self, outcome: Outcome) -> None:
        self._say(outcome.code, outcome.text or "exploration ended with proof")
        self.ctx.send_goal(FINISH_MAP, Nothing(), lambda _: self._save(outcome))

    def _save(self, outcome: Outcome) -> None:
        self.ctx.call(SAVE_MAP, SaveMapRequest(self._map_stem), lambda reply: self._saved(reply, outcome))

    def _saved(self, reply: Nothing | Exception, outcome: Outcome) -> None:
        if isinstance(reply, Exception):
            self._say("MAP_NOT_SAVED", str(reply))
            outcome = TaskOutcome("MAP_NOT_SAVED", str(reply), outcome.result)
        if self._saves_glass:
            self._saves_glass = False
            self.ctx.call(SAVE_GLASS, SaveMapRequest(self._map_stem), lambda reply: self._saved(reply, outcome))
            return
        self._on_finished(outcome)

    def _say(self, code: str, text: str) -> None:
        self.ctx.log(code, text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text))
