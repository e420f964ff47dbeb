"""The protective field: exact against a slow twin, monotone in the speed, blind to who looks at it; and its kernels' mutants die."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.kernels import protective_field as kernels
from ambler.kernels.footprint import footprint_corners, footprint_edges
from ambler.safety.field import ProtectiveField
from tests.safety.invariants import BOX, cluster

TRIANGLE = np.array([[0.6, 0.0], [-0.2, 0.3], [-0.2, -0.3]])
HEXAGON = np.array([[0.35 * math.cos(a), 0.35 * math.sin(a)] for a in np.arange(6) * math.pi / 3])
SHAPES = {"box": BOX.footprint, "triangle": TRIANGLE, "hexagon": HEXAGON}
VELOCITIES = st.builds(BodyVelocity, st.floats(-0.3, 0.8), st.floats(-0.4, 0.4), st.floats(-1.5, 1.5))
PLACES = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
MARGIN, NEARER, DEPTH = 0.03, 1e-4, 0.05
GRAZE = 1e-7  # metres within which rounding decides whether a point is touched


def contact(
    shape: np.ndarray,
    points: np.ndarray,
    twist: tuple[float, float, float],
    horizon: float,
    count: int,
    shift: float = 0.0,
) -> float:
    """Return the kernel's time, with every limit of clearance moved outwards by `shift`."""
    normals, offsets = footprint_edges(shape, 0.0)
    radius = float(np.hypot(*footprint_corners(normals, offsets + MARGIN + shift).T).max())
    return float(
        kernels.contact_time(
            points, normals, offsets, radius, np.array(twist), horizon, MARGIN + shift, NEARER - shift, DEPTH, count
        )
    )


def sampled_contact(
    shape: np.ndarray, points: np.ndarray, twist: tuple[float, float, float], horizon: float, count: int, step: float
) -> float:
    """The slow twin: look at poses every `step` seconds."""
    normals, offsets = footprint_edges(shape, 0.0)

    def clearance(t: float) -> np.ndarray:
        moved = SE2.exp(np.array(twist) * t).inverse().transform(points)
        return np.asarray(np.max(moved @ normals.T - offsets, axis=1))

    at_once = clearance(0.0)
    limit = np.minimum(MARGIN, at_once - NEARER)
    first = np.full(len(points), np.inf)
    for t in np.arange(step, horizon, step)[::-1]:
        first[clearance(float(t)) < limit] = t
    first = np.sort(first[at_once > -DEPTH])
    return float(first[count - 1]) if len(first) >= count else math.inf


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("horizon", [0.8, 6.0])
def test_contact_time_equals_that_of_a_slow_twin(shape: str, horizon: float) -> None:
    """6 s at 1.5 rad/s are more than a whole turn."""
    rng, step = np.random.default_rng(len(shape)), 0.004
    hits = 0
    for trial in range(40):
        points = rng.uniform(-1.2, 1.2, (int(rng.integers(1, 12)), 2))
        twist = tuple(rng.uniform([-0.8, -0.4, -1.5], [0.8, 0.4, 1.5]) * (rng.random(3) > 0.25))
        for count in (1, 2, 3):
            slow = sampled_contact(SHAPES[shape], points, twist, horizon, count, step)
            fast = contact(SHAPES[shape], points, twist, horizon, count)
            assert fast <= slow, f"trial {trial}: sampled poses touch before the kernel says so"
            if math.isinf(slow):  # a corner may pass between two poses, but never deep
                fast = contact(SHAPES[shape], points, twist, horizon - step, count, shift=-0.005)
                assert math.isinf(fast), f"trial {trial}"
            else:
                assert contact(SHAPES[shape], points, twist, horizon, count, shift=-0.005) >= slow - step - 1e-9
                hits += fast > 0.0
    assert hits > (8 if horizon < 1.0 else 20)


def test_contact_times_by_hand() -> None:
    ahead, beside = np.array([[0.93, 0.1]]), np.array([[0.0, 0.5]])
    assert contact(BOX.footprint, ahead, (0.5, 0.0, 0.0), 2.0, 1) == pytest.approx(1.0, abs=1e-12)
    assert contact(BOX.footprint, ahead, (0.5, 0.0, 0.0), 0.99, 1) == math.inf
    assert contact(BOX.footprint, ahead, (-0.5, 0.0, 0.0), 9.0, 1) == math.inf
    # Turning on the spot, the front left corner of the padded box (0.43, 0.23) meets a point on the left at its own radius ...
    radius, corner = math.hypot(0.43, 0.23), math.atan2(0.23, 0.43)
    point = (radius - 1e-9) * np.array([[math.cos(corner + 0.4), math.sin(corner + 0.4)]])
    assert contact(BOX.footprint, point, (0.0, 0.0, 1.0), 1.0, 1) == pytest.approx(0.4, abs=1e-5)
    # ... but not one a hair farther out; and to the right the rear left corner comes after 2 acos(...) more.
    assert contact(BOX.footprint, point * (1.0 + 1e-6), (0.0, 0.0, 1.0), 9.0, 1) == math.inf
    rest = math.pi - 2.0 * corner - 0.4
    assert contact(BOX.footprint, point, (0.0, 0.0, -1.0), 9.0, 1) == pytest.approx(rest, abs=1e-5)
    # A turn so slight that the centre of the circle lies 10^9 m away is a straight line.
    assert contact(BOX.footprint, beside, (0.0, 0.3, 3e-10), 2.0, 1) == pytest.approx(0.9, abs=1e-8)


FIELD = ProtectiveField(BOX, 0.2, MARGIN, 2, DEPTH)
CLOSER, WIDER = (ProtectiveField(BOX, 0.2, MARGIN + shift, 2, DEPTH) for shift in (-GRAZE, GRAZE))
AT_ONCE = (
    1e-5  # metres; nearer to the margin than this a point may count as inside of one margin and outside of the other
)


def scaled(v: BodyVelocity, share: float) -> BodyVelocity:
    return BodyVelocity(v.vx * share, v.vy * share, v.wz * share)


@given(VELOCITIES, PLACES, st.floats(0.05, 1.0))
@example(BodyVelocity(0.0, -0.0625, 0.34375), (0.40625, 0.0), 0.9)
@example(BodyVelocity(0.0, -0.0625, 0.34375), (0.40625, 0.0), 0.5)
@example(BodyVelocity(0.0, -0.0625, 0.34375), (0.40625, 0.0), 0.4)
@example(BodyVelocity(0.0, -0.0625, 0.34375), (0.40625, 0.0), 0.3)
@settings(max_examples=400, deadline=None)
def test_a_slower_motion_on_the_same_arc_is_never_less_free(
    v: BodyVelocity, place: tuple[float, float], share: float
) -> None:
    """`s * free_scale(s v) = min(s, free_scale(v))`: at every share of a velocity the same absolute speed is allowed."""
    points = cluster(*place)
    free = FIELD.free_scale(v, points)
    slow = share * FIELD.free_scale(scaled(v, share), points)
    if not math.isclose(slow, min(share, free), abs_tol=1e-7):  # unless the point grazes the margin
        low, high = WIDER.free_scale(v, points), CLOSER.free_scale(v, points)
        assert high - low > 1e-3
        assert min(share, low) - 1e-6 <= slow <= min(share, high) + 1e-6


def test_the_arc_that_was_less_free_when_slower() -> None:
    """It gave 0, 0.35, 0.27, 0 and 0.30 at these shares while poses were sampled."""
    v, points = BodyVelocity(0.0, -0.0625, 0.34375), cluster(0.40625, 0.0)
    shares = (1.0, 0.9, 0.5, 0.4, 0.3)
    speeds = [share * FIELD.free_scale(scaled(v, share), points) for share in shares]
    assert speeds[:4] == pytest.approx([speeds[0]] * 4, abs=1e-12)
    assert speeds[0] == pytest.approx(0.38363, abs=1e-5)
    assert speeds[4] == 0.3


@given(VELOCITIES, st.lists(PLACES, min_size=1, max_size=4))
@settings(max_examples=200, deadline=None)
def test_left_and_right_are_alike(v: BodyVelocity, places: list[tuple[float, float]]) -> None:
    points = np.concatenate([cluster(*p) for p in places])
    mirrored = BodyVelocity(v.vx, -v.vy, -v.wz)
    free, other = FIELD.free_scale(v, points), FIELD.free_scale(mirrored, points * [1.0, -1.0])
    if not math.isclose(free, other, abs_tol=1e-7):
        assert CLOSER.free_scale(v, points) - WIDER.free_scale(v, points) > 1e-3


@given(VELOCITIES, st.lists(PLACES, min_size=1, max_size=4), PLACES)
@settings(max_examples=200, deadline=None)
def test_one_more_point_never_frees(
    v: BodyVelocity, places: list[tuple[float, float]], one: tuple[float, float]
) -> None:
    points = np.concatenate([cluster(*p) for p in places])
    assert FIELD.free_scale(v, np.concatenate((points, cluster(*one)))) <= FIELD.free_scale(v, points)


@given(st.floats(0.05, 0.8), st.floats(-0.04, 0.0), st.floats(-0.15, 0.15))
def test_a_point_inside_the_footprint_stops_the_robot(vx: float, depth: float, y: float) -> None:
    points = cluster(0.4 + depth, y)
    assert FIELD.free_scale(BodyVelocity(vx), points) * vx * 0.2 <= NEARER
    assert FIELD.free_scale(BodyVelocity(-vx), points) == 1.0


@given(VELOCITIES, PLACES)
@settings(max_examples=100, deadline=None)
def test_the_margin_is_kept_to_a_hair_and_not_more(v: BodyVelocity, place: tuple[float, float]) -> None:
    """A robot held back comes to rest where the second point of a thing touches the margin."""
    normals, offsets = footprint_edges(BOX.footprint, 0.0)
    points = cluster(*place)
    at_once = np.max(points @ normals.T - offsets, axis=1)
    assume(np.all(at_once > MARGIN + AT_ONCE))
    share = FIELD.free_scale(v, points)
    braking = float(kernels.braking_time(v.vx, v.vy, v.wz, BOX.limits.ax_brake, BOX.limits.ay_brake, BOX.limits.az_max))
    end = float(kernels.stopping_time(share, 0.2, braking))
    for t in np.linspace(0.0, end, 50):
        moved = SE2.exp(np.array([v.vx, v.vy, v.wz]) * t).inverse().transform(points)
        clearance = np.sort(np.max(moved @ normals.T - offsets, axis=1))
        assert clearance[1] > MARGIN - 1e-7
    if share < 1.0:
        assert clearance[1] == pytest.approx(MARGIN, abs=1e-7)


def test_a_sharp_corner_has_its_margin_too() -> None:
    """The margin's corner before a tip of 20 degrees lies 17 cm before the tip, far outside of the footprint's circle."""
    tip = np.array([[0.6, 0.0], [0.0, 0.6 * math.tan(math.radians(10))], [0.0, -0.6 * math.tan(math.radians(10))]])
    field = ProtectiveField(replace(BOX, footprint=tip), 0.0, MARGIN, 2, DEPTH)
    corner = 0.6 + MARGIN / math.sin(math.radians(10))
    assert field.free_scale(BodyVelocity(0.0, 0.0, 0.1), np.array([[corner - 0.002, 0.001]] * 2)) < 1.0
    assert field.free_scale(BodyVelocity(0.0, 0.0, 0.1), np.array([[corner + 0.001, 0.0]] * 2)) == 1.0


def checked_by_hand(m: ModuleType) -> None:
    """Enough cases to catch a damaged kernel; in plain Python, so few."""
    normals, offsets = footprint_edges(BOX.footprint, 0.0)
    radius = math.hypot(0.43, 0.23)
    rng = np.random.default_rng(3)
    assert m.safe_scale(0.0, 0.0, 1.0) == 0.0
    assert m.safe_scale(0.5, 0.0, 1.0) == 1.0
    assert m.safe_scale(0.02, 0.2, 0.0) == pytest.approx(0.1)
    assert m.safe_scale(m.stopping_time(0.4, 0.2, 0.6), 0.2, 0.6) == pytest.approx(0.4)
    assert m.stopping_time(1.0, 0.2, 0.6) == pytest.approx(0.5)
    assert m.braking_time(0.5, -0.6, 0.0, 0.5, 2.0, 4.0) == 1.0
    assert m.braking_time(-0.5, 0.6, -3.0, 1.0, 0.5, 4.0) == 1.2
    assert m.braking_time(0.0, 0.0, -3.0, 1.0, 0.5, 4.0) == 0.75
    assert m.contact_time(np.ones((3, 2)), normals, offsets, radius, np.zeros(3), 1.0, 0.03, 1e-4, 0.05, 2) == math.inf
    long, limits = footprint_edges(np.array([[2.0, -0.2], [2.0, 0.2], [-2.0, 0.2], [-2.0, -0.2]]), 0.0)
    beside, turn = np.array([[1.9, 0.6]]), np.array([0.0, 0.0, 1.0])
    angle = math.atan2(0.6, 1.9) - math.asin(0.23 / math.hypot(0.6, 1.9))
    assert m.contact_time(beside, long, limits, 2.1, turn, 0.2, 0.03, 1e-4, 0.05, 1) == pytest.approx(angle, abs=1e-12)
    pose, two, carried = SE2(0.3, -0.7, 0.9), np.array([[1.5, -0.4], [0.2, 0.9]]), np.full((5, 2), np.nan)
    place = (pose.x, pose.y, math.cos(pose.yaw), math.sin(pose.yaw))
    assert m.carry_points(two, *place, 1, carried) == 3
    assert m.carry_points(two + 1.0, *place, 3, carried) == 5
    assert np.isnan(carried[0]).all()
    assert np.array_equal(carried[1:], pose.transform(np.concatenate((two, two + 1.0))))  # to the bit
    for k in range(300):
        points = rng.uniform(-0.9, 0.9, (3, 2))
        points[2] = points[1] + [0.0, 0.001]
        straight = 0.0 if k % 3 == 0 else float(rng.choice([-1e-10, 1.5, -1.5, 0.3]))
        twist = np.array([*rng.choice([-0.6, 0.0, 0.5], 2), straight])
        horizon = float(rng.choice([0.3, 1.0, 6.0]))
        count = 1 + k % 2
        args = (points, normals, offsets, radius, twist, horizon, 0.03, 1e-4, 0.05, count)
        assert m.contact_time(*args) == pytest.approx(kernels.contact_time(*args), abs=1e-9)


def test_every_mutant_of_the_kernels_is_caught() -> None:
    """In plain Python the kernels do the same; with one comparison, sign or sum changed they do not."""
    source = Path(kernels.__file__).read_text().replace("@jit_short\n", "").split("def warm_up")[0]
    checked_by_hand(module_of(source))
    survivors, total = [], 0
    for index, original in enumerate(ast.walk(ast.parse(source))):
        if not isinstance(original, ast.Compare | ast.BoolOp | ast.BinOp | ast.UnaryOp):
            continue
        tree = ast.parse(source)
        node = list(ast.walk(tree))[index]
        if not damage(node):
            continue
        total += 1
        try:
            checked_by_hand(module_of(ast.unparse(ast.fix_missing_locations(tree))))
        except Exception:  # noqa: BLE001  (a mutant may die in any way)
            continue
        survivors.append(f"{node.lineno}: {ast.unparse(node)}")  # type: ignore[attr-defined]
    assert total > 80
    assert survivors == []


def module_of(source: str) -> ModuleType:
    module = ModuleType("damaged")
    exec(compile(source, "damaged.py", "exec"), module.__dict__)
    return module


def damage(node: ast.AST) -> bool:
    """Change one node; returns whether it was changed."""
    if isinstance(node, ast.Compare):
        flip = {
            ast.Lt: ast.GtE,
            ast.LtE: ast.Gt,
            ast.Gt: ast.LtE,
            ast.GtE: ast.Lt,
            ast.Eq: ast.NotEq,
            ast.NotEq: ast.Eq,
        }
        node.ops[0] = flip[type(node.ops[0])]()
    elif isinstance(node, ast.BoolOp):
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    elif isinstance(node, ast.BinOp):
        swap = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
        node.op = swap[type(node.op)]()
    elif isinstance(node, ast.UnaryOp):
        node.operand = ast.UnaryOp(node.op, node.operand)
    return True
