"""The gate keeps its invariants; and every damaged comparison in its source breaks at least one of them."""

import ast
import importlib
import math
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ambler.safety.field as field_module
import ambler.safety.gate as gate_module
from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.kernels.footprint import edge_clearance, footprint_edges
from tests.safety.invariants import BOX, CHECKS, LIMITS, Bench, cluster

SAFETY = Path(gate_module.__file__).parent
FLIP = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


def mutants(name: str) -> Iterator[tuple[str, ModuleType]]:
    """Give every module that differs from the source in one comparison, one `and`/`or`, or one sign or `not`."""
    source = (SAFETY / f"{name}.py").read_text()
    for index, original in enumerate(ast.walk(ast.parse(source))):
        if not isinstance(original, ast.Compare | ast.BoolOp | ast.UnaryOp):
            continue
        tree = ast.parse(source)
        node = list(ast.walk(tree))[index]
        if isinstance(node, ast.Compare):
            node.ops[0] = FLIP[type(node.ops[0])]()
        elif isinstance(node, ast.BoolOp):
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        elif isinstance(node, ast.UnaryOp):
            node.operand = ast.UnaryOp(node.op, node.operand)
        ast.fix_missing_locations(tree)
        module = ModuleType(f"mutant_{name}_{index}")
        module.__dict__["__name__"] = f"ambler.safety.{name}"
        exec(compile(tree, f"{name}.py", "exec"), module.__dict__)
        yield f"{name}.py:{getattr(node, 'lineno', 0)}: {ast.unparse(node)}", module


@pytest.mark.parametrize("name", CHECKS)
def test_invariants(name: str) -> None:
    module = importlib.import_module(f"ambler.safety.{name}")
    for check in CHECKS[name]:
        check(module)


@pytest.mark.parametrize("name", CHECKS)
def test_every_mutant_is_caught(name: str) -> None:
    survivors, total = [], 0
    for text, module in mutants(name):
        total += 1
        try:
            for check in CHECKS[name]:
                check(module)
        except Exception:  # noqa: BLE001  (a mutant may die in any way)
            continue
        survivors.append(text)
    assert total >= 3 or name == "field"  # it compares nothing: its kernels have mutants of their own
    assert not survivors


VELOCITIES = st.builds(BodyVelocity, st.floats(-0.3, 0.8), st.floats(-0.4, 0.4), st.floats(-1.5, 1.5))
PLACES = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
FIELD = field_module.ProtectiveField(BOX, 0.2, 0.03, 2, 0.05)


@given(VELOCITIES, st.lists(PLACES, min_size=1, max_size=6))
@settings(max_examples=150, deadline=None)
def test_stopping_from_the_allowed_speed_touches_nothing(v: BodyVelocity, places: list[tuple[float, float]]) -> None:
    normals, offsets = footprint_edges(BOX.footprint, 0.0)
    outside = [p for p in places if edge_clearance(*p, normals, offsets) > 0.006]
    points = np.concatenate([np.empty((0, 2)), *[cluster(*p) for p in outside]])
    scale = FIELD.free_scale(v, points)
    braking = field_module.braking_time(v, LIMITS)
    end = field_module.stopping_time(scale, 0.2, braking)
    for t in np.linspace(0.0, end, 60):
        pose = field_module_pose(v, float(t))
        for x, y in pose.inverse().transform(points):
            assert edge_clearance(x, y, normals, offsets) > -0.011


@given(st.lists(PLACES, min_size=1, max_size=5), st.tuples(*[st.floats(-2, 2)] * 3))
@settings(max_examples=25, deadline=None)
def test_the_robot_never_drives_into_anything(
    places: list[tuple[float, float]], ask: tuple[float, float, float]
) -> None:
    normals, offsets = footprint_edges(BOX.footprint, 0.0)
    outside = [p for p in places if edge_clearance(*p, normals, offsets) > 0.006]
    world = np.concatenate([np.empty((0, 2)), *[cluster(*p) for p in outside]])
    b = Bench(gate_module)
    for _ in range(80):
        b.points = np.concatenate((b.pose.inverse().transform(world), [[50.0, 0.0]]))
        b.tick(1, ask)
        for x, y in b.pose.inverse().transform(world):
            assert edge_clearance(x, y, normals, offsets) > 0.0


def field_module_pose(v: BodyVelocity, t: float) -> SE2:
    return SE2.exp(np.array([v.vx, v.vy, v.wz]) * t)


def test_a_wedged_robot_is_free_within_a_moment() -> None:
    b = Bench(gate_module)
    b.points = np.concatenate((cluster(0.41, 0.1), cluster(0.41, -0.1)))
    assert b.tick(20, (0.5, 0.0, 0.3)).state == GateState.PROTECTIVE_STOP
    world = b.pose.transform(b.points)
    ticks = 0
    while b.pose.x > -0.2:
        b.points = b.pose.inverse().transform(world)
        b.tick(1, (-0.2, 0.0, 0.0))
        ticks += 1
        assert ticks * 0.02 < 3.0
    assert math.isclose(b.pose.y, 0.0, abs_tol=1e-9)
