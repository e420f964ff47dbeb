"""Strangers at the door of a robot that drives: all answers are counted, and a wrong or a missing one is noticed."""

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from ambler.apps.scene import RunOptions
from ambler.core.requests import PlanReply
from ambler.runtime.door import OutsideDoor
from ambler.runtime.tasks import ARM, COMPUTE_PATH
from ambler.studies import bench_door

OPTIONS = RunOptions(world="lab_empty", robot="diff", physics="kinematic", port=None)


def visit(out: Path, executor: str = "lockstep") -> dict[str, Any]:
    return bench_door.measure(OPTIONS, 48, out, lambda text: None, [executor])


def test_every_stranger_is_answered_and_the_run_is_repeated_to_the_bit(tmp_path: Path) -> None:
    found = visit(tmp_path)
    assert found["bars.door"]
    assert (found["lockstep.calls"], found["lockstep.goals"], found["lockstep.answered"]) == (40, 8, 48)
    assert found["lockstep.lost"] == found["lockstep.wrong"] == 0
    assert found["lockstep.is_replay_equal"]
    assert found["lockstep.driven_m"] > 0.05
    assert sum(found.get(f"lockstep.goals_{code}", 0) for code in ("preempted", "cancelled", "succeeded")) == 8


def test_an_answer_to_somebody_elses_question_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, kept = OutsideDoor.call, list[Future[PlanReply]]()

    def mixed_up(self: OutsideDoor, service: Any, request: Any) -> Any:
        answer = real(self, service, request)
        if service is COMPUTE_PATH:
            kept.append(answer)
            return kept[0]
        return answer

    monkeypatch.setattr(OutsideDoor, "call", mixed_up)
    found = visit(tmp_path)
    assert found["lockstep.wrong"] > 5
    assert not found["bars.door"]


def test_an_answer_that_never_comes_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = OutsideDoor.call

    def silent(self: OutsideDoor, service: Any, request: Any) -> Any:
        is_lost = service is ARM and request.reason.endswith(".2")
        return Future() if is_lost else real(self, service, request)

    monkeypatch.setattr(OutsideDoor, "call", silent)
    monkeypatch.setattr(bench_door, "PATIENCE", 3.0)
    found = visit(tmp_path)
    assert found["lockstep.lost"] >= 4
    assert not found["bars.door"]
