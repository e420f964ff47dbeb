"""Does what a person would do with a robot and its docks: arms it, waits until it knows where it is, sends it on errands in turn."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field

from ambler.nodes.pilot import Journey, PilotConfig, PilotNode
from ambler.runtime.node import TaskOutcome
from ambler.runtime.tasks import (
    ARM,
    DOCK,
    RECOVER,
    TEACH_DOCK,
    UNDOCK,
    DockFeedback,
    DockGoal,
    DockReport,
    TeachDockReply,
    TeachDockRequest,
    UndockGoal,
)


class ErrandKind(enum.Enum):
    """What to do with a dock."""

    DOCK = "dock"
    UNDOCK = "undock"
    TEACH = "teach"


@dataclass(frozen=True, slots=True)
class Errand:
    """One thing to do with one dock."""

    kind: ErrandKind
    dock: str


@dataclass(frozen=True, slots=True)
class ErrandEnd:
    """How an errand ended; `report` is None where there is nothing to tell. Instants of the executor."""

    errand: Errand
    code: str
    text: str
    report: DockReport | None
    begun_ns: int
    ended_ns: int


@dataclass(slots=True)
class DockRounds:
    """What came of a list of errands; `states` are the states of docking with the instants at which they were told."""

    ends: list[ErrandEnd] = field(default_factory=list)
    states: list[tuple[int, str]] = field(default_factory=list)
    is_localized: bool = True

    @property
    def is_success(self) -> bool:
        return self.is_localized and all(end.code == "SUCCEEDED" for end in self.ends)


class DockPilotNode(PilotNode):
    """Runs errands, one after the other until one fails, and calls `on_finished` with what came of them."""

    name = "pilot"
    calls = (ARM, RECOVER, DOCK, UNDOCK, TEACH_DOCK)

    def __init__(
        self, errands: tuple[Errand, ...], on_finished: Callable[[DockRounds], None], config: PilotConfig | None = None
    ) -> None:
        super().__init__(config if config is not None else PilotConfig(), self._journey_over)
        self._errands = errands
        self._on_rounds = on_finished
        self._begun_ns = 0
        self.rounds = DockRounds()

    def _journey_over(self, journey: Journey) -> None:
        """The robot never knew where it is."""
        self.rounds.is_localized = journey.is_localized
        self._on_rounds(self.rounds)

    def _next_goal(self) -> None:
        done = len(self.rounds.ends)
        if done == len(self._errands) or not self.rounds.is_success:
            self._on_rounds(self.rounds)
            return
        errand = self._errands[done]
        self._begun_ns = self.ctx.now_ns
        self._say(errand.kind.name, errand.dock)
        if errand.kind is ErrandKind.DOCK:
            self.ctx.send_goal(DOCK, DockGoal(errand.dock), self._over, self._feedback)
        elif errand.kind is ErrandKind.UNDOCK:
            self.ctx.send_goal(UNDOCK, UndockGoal(errand.dock), self._over, self._feedback)
        else:
            self.ctx.call(TEACH_DOCK, TeachDockRequest(errand.dock), self._taught)

    def _feedback(self, feedback: DockFeedback) -> None:
        states = self.rounds.states
        if not states or states[-1][1] != feedback.state:
            states.append((self.ctx.now_ns, feedback.state))

    def _over(self, outcome: TaskOutcome[DockReport]) -> None:
        self._close(outcome.code, outcome.text, outcome.result)

    def _taught(self, reply: TeachDockReply | Exception) -> None:
        if isinstance(reply, Exception):
            self._close("NOT_TAUGHT", str(reply), None)
        else:
            pose = reply.map_from_dock
            self._close("SUCCEEDED", f"taught at {pose.x:.3f}, {pose.y:.3f}, {pose.yaw:.4f} rad", None)

    def _close(self, code: str, text: str, report: DockReport | None) -> None:
        errand = self._errands[len(self.rounds.ends)]
        self.rounds.ends.append(ErrandEnd(errand, code, text, report, self._begun_ns, self.ctx.now_ns))
        self._say(code, text)
        self._next_goal()
