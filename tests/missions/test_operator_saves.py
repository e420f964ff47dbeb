"""What the operator saves at the end: the map first, and nothing that cannot be saved takes anything else with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ambler.core.errors import BadInputError
from ambler.nodes.operator import OperatorConfig, OperatorNode
from ambler.nodes.steps import ExploreStep
from ambler.runtime.node import TaskOutcome
from ambler.runtime.tasks import SAVE_CLOUD, SAVE_GRAPH, SAVE_MAP, SAVE_STATIONS, EndProgramRequest, Nothing
from tests.hand_made_context import HandMadeContext


class SavingContext(HandMadeContext):
    """Answers every service at once; those in `broken` fail."""

    def __init__(self, broken: set[str]) -> None:
        super().__init__()
        self.called: list[str] = []
        self._broken = broken

    def call(self, service: Any, request: Any, then: Any) -> None:
        """Remember the call and answer it."""
        self.called.append(service.name)
        then(BadInputError(f"no {service.name}") if service.name in self._broken else Nothing())


@pytest.mark.parametrize("broken", [set(), {SAVE_CLOUD.name}, {SAVE_MAP.name, SAVE_GRAPH.name}, {SAVE_STATIONS.name}])
def test_everything_that_can_be_saved_is_and_what_cannot_is_named(tmp_path: Path, broken: set[str]) -> None:
    ended: list[Any] = []
    config = OperatorConfig(str(tmp_path / "map"), (SAVE_CLOUD, SAVE_STATIONS, SAVE_GRAPH))
    node, context = OperatorNode((ExploreStep(),), config, ended.append), SavingContext(broken)
    node.ctx = context  # type: ignore[assignment]
    node._on_end_program(EndProgramRequest("TIME_LIMIT", "enough"))
    assert context.called == [SAVE_MAP.name, SAVE_CLOUD.name, SAVE_STATIONS.name, SAVE_GRAPH.name]
    assert ended[0].code == ("MAP_NOT_SAVED" if broken else "TIME_LIMIT")
    assert all(name in ended[0].text for name in broken)


def test_what_an_exploration_says_of_its_end_is_told(tmp_path: Path) -> None:
    """It had been told as ended with proof, whatever it said itself."""
    node, context = (
        OperatorNode((ExploreStep(),), OperatorConfig(str(tmp_path / "map")), lambda _: None),
        SavingContext(set()),
    )
    node.ctx = context  # type: ignore[assignment]
    context.send_goal = lambda *_: None  # type: ignore[attr-defined]
    node._explored(TaskOutcome("SUCCEEDED", "7 could not be reached among people", None))
    assert node._ends[0].text == "7 could not be reached among people"
