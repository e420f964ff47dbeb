"""The random search finds nothing wrong with the gate, and finds every fault that is planted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.protocols import BodyVelocity
from ambler.evaluation.gate_search import GateSearchResult, broken_promise, check_gate, search_gate
from ambler.kernels import gate_search as kernels
from ambler.kernels.protective_field import free_scale
from tests.safety.invariants import LIMITS

Field = Callable[..., float]


def in_steps(points: Any, normals: Any, offsets: Any, radius: float, twist: Any, braking: float, *rest: Any) -> float:
    """The rule of old: look at the pose of every second centimetre."""
    reaction, *others = rest
    horizon = kernels.stopping_time(1.0, reaction, braking)
    steps = max(1, int(np.ceil((np.hypot(twist[0], twist[1]) + abs(twist[2]) * radius) * horizon / 0.02)))
    allowed = free_scale(points, normals, offsets, radius, twist, braking, reaction, *others)
    if allowed >= 1.0:
        return 1.0
    k = np.floor(kernels.stopping_time(allowed, reaction, braking) / horizon * steps)
    contact = k * horizon / steps
    return float(min(1.0, 2.0 * contact / (reaction + np.sqrt(reaction**2 + 2.0 * braking * contact) + 1e-300)))


FAULTS: dict[str, Field] = {
    "monotone": in_steps,
    "bounded": lambda *a: 1.1 * free_scale(*a),
    "safe": lambda *a: min(1.0, 1.05 * free_scale(*a)),
    "careful": lambda *a: free_scale(*a) if free_scale(*a) >= 1.0 else 0.95 * free_scale(*a),
    "mirrored": lambda *a: free_scale(*a) if a[4][1] < 0.2 else free_scale(*a[:8], a[8] * 0.98, *a[9:]),
    "turned": lambda *a: free_scale(a[0], a[1] + [0.0, 1e-5], *a[2:]),
    "crowded": lambda *a: free_scale(*a) if len(a[0]) % 7 else free_scale(*a[:10], a[10] + 1),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_of_the_field_is_found(name: str) -> None:
    """In plain Python, with a damaged field in place of the real one."""
    module = ModuleType("search")
    source = Path(kernels.__file__).read_text().replace("@jit\n", "")
    exec(compile(source, "search.py", "exec"), module.__dict__)
    module.__dict__["free_scale"] = FAULTS[name]
    corners, points = np.empty((kernels.EDGES_MOST, 2)), np.empty((kernels.POINTS_MOST, 2))
    counts, grazes = np.zeros(len(kernels.PROPERTIES), np.int64), np.zeros(1, np.int64)
    chances, row = np.random.default_rng(1).random((400, kernels.CHANCES)), 0
    while row < len(chances):
        row += 1 + module.search(chances[row:], counts, grazes, corners, points, np.empty(3), np.empty(7))[0]
    found = dict(zip(kernels.PROPERTIES, counts.tolist(), strict=True))
    assert sum(found.values()) > 0
    if name in ("bounded", "safe", "careful"):
        assert found[name] > 0, found


def test_the_real_gate_has_no_counterexample() -> None:
    result = search_gate(40_000, 7)
    assert result.cases == 40_000
    assert result.counterexamples == 0, result.example
    assert result.gate_moving > 100


def test_the_same_seed_draws_the_same_cases() -> None:
    first, second = GateSearchResult(), GateSearchResult()
    for result in (first, second):
        rng = np.random.default_rng(4)
        for _ in range(5):
            check_gate(rng, result)
    assert first == second
    assert first.gate_moving > 20


@pytest.mark.parametrize(
    ("out", "name"),
    [
        (BodyVelocity(0.2, 0.1, -0.2), None),
        (BodyVelocity(), None),
        (BodyVelocity(float("nan"), 0.1, -0.2), "finite"),
        (BodyVelocity(0.9, 0.45, -0.9), "limited"),
        (BodyVelocity(0.2, 0.1, -1.6), "limited"),
        (BodyVelocity(0.5, 0.25, -0.5), "raised"),
        (BodyVelocity(-0.2, -0.1, 0.2), "raised"),
        (BodyVelocity(0.2, 0.1, -0.1), "bent"),
        (BodyVelocity(0.2, 0.05, -0.2), "bent"),
    ],
)
def test_broken_promises_are_named(out: BodyVelocity, name: str | None) -> None:
    assert broken_promise(out, BodyVelocity(0.4, 0.2, -0.4), LIMITS) == name


def test_the_verb_says_how_many_and_refuses_nonsense(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "g.json"
    assert main(["eval", "gate", "--runs", "3000", "--seed", "2", "--seeds", "2", "--json", str(file)]) == 0
    assert "seed 3: 3000 cases, 0 counterexamples" in capsys.readouterr().out
    assert '"cases": 6000' in file.read_text()
    assert main(["eval", "gate", "--runs", "0"]) == 2
