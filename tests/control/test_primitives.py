"""Motion primitives: the library's geometry, sweeps of the true footprint against brute force, the scoring against NumPy, and what the planner makes of it."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from ambler.control.dead_ends import DeadEnds
from ambler.control.local_window import LocalWindow
from ambler.control.motion_primitives import MotionPrimitives
from ambler.control.path_follower import FollowerConfig, PathFollower
from ambler.control.primitive_choice import Manner, PrimitiveChooser
from ambler.control.primitive_library import primitive_library
from ambler.control.primitive_sweeps import ANGLES, following_table, holding_table
from ambler.control.primitives_config import PrimitivesConfig
from ambler.core.errors import NoValidControlError
from ambler.core.grid import GridSpec
from ambler.core.movers import Movers
from ambler.core.protocols import BodyVelocity, Lean, LocalState
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import arc, footprint, primitives, rollout, warmup
from ambler.kernels.footprint import footprint_edges
from ambler.kernels.primitives import LEVELS, WORDS, block_paths, score_groups
from tests.control.closed_loop import DIFF, ROBOTS, SPOT, Drive, World, drive, line

EGG = np.array([[0.4, -0.1], [0.4, 0.1], [-0.2, 0.3], [-0.2, -0.3]])
"""A footprint that is not the same forward and backwards."""


# The library


def test_the_library_is_343_paths_that_fan_out_three_times() -> None:
    library = primitive_library()
    assert library.points.shape == (343, 301, 2)
    assert np.bincount(library.groups).tolist() == [49] * 7
    r = np.hypot(library.points[..., 0], library.points[..., 1])
    np.testing.assert_allclose(r, np.broadcast_to(np.arange(301) * 0.01, r.shape), atol=1e-12)
    bearings = np.degrees(np.arctan2(library.points[..., 1], library.points[..., 0]))
    k = np.arange(343)
    first = -27.0 + 9.0 * (k // 49)
    second = first + 0.65 * (-27.0 + 9.0 * (k // 7 % 7))
    third = second + 0.65**2 * (-27.0 + 9.0 * (k % 7))
    np.testing.assert_allclose(bearings[:, 1:101], first[:, None] * np.arange(1, 101) * 0.01, atol=1e-9)
    np.testing.assert_allclose(bearings[:, 200], second, atol=1e-9)
    np.testing.assert_allclose(bearings[:, 300], third, atol=1e-9)
    np.testing.assert_allclose(np.degrees(library.end_directions), 2.0 * third, atol=1e-9)


def test_the_library_is_its_own_mirror_image_and_its_headings_are_tangents() -> None:
    library = primitive_library()
    mirrored = library.points[::-1] * (1.0, -1.0)
    np.testing.assert_allclose(library.points, mirrored, atol=1e-9)
    step = np.diff(library.points, axis=1)
    chord = np.arctan2(step[..., 1], step[..., 0])
    middle = 0.5 * (library.headings[:, :-1] + library.headings[:, 1:])
    assert np.abs(wrap(chord - middle)).max() < 5e-3
    np.testing.assert_allclose(library.start(6), library.points[300, :101], atol=1e-12)


def wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


# Sweeps


def clearances(points: np.ndarray, scale: float, headings: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """The least signed distance of points (N, 2) to the edges of a footprint along every path (P,): a slow, independent check."""
    library = primitive_library()
    normals, offsets = footprint_edges(polygon, 0.0)
    out = np.empty((len(points), 343))
    for k in range(343):
        at, a = library.points[k] * scale, headings[k]
        d = points[:, None] - at[None]
        x = d[..., 0] * np.cos(a) + d[..., 1] * np.sin(a)
        y = d[..., 1] * np.cos(a) - d[..., 0] * np.sin(a)
        signed = np.max(x[..., None] * normals[:, 0] + y[..., None] * normals[:, 1] - offsets, axis=-1)
        out[:, k] = signed.min(axis=1)
    return out


def is_met(bitmap: np.ndarray) -> np.ndarray:
    """Unpack bitmaps (..., WORDS) into bool (..., 343)."""
    bits = (bitmap[..., None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    return bits.reshape(*bitmap.shape[:-1], 64 * WORDS)[..., :343].astype(bool)


@pytest.mark.parametrize("manner", ["forward", "backwards", "holding"])
def test_a_sweep_blocks_what_the_true_footprint_meets_and_nothing_else(manner: str) -> None:
    scale, padding, d = 0.65, 0.03, 23
    headings = primitive_library().headings
    if manner == "holding":
        table, layer = holding_table(EGG, padding, scale), d
        headings = np.full_like(headings, -ANGLES[d])
    else:
        table, layer = following_table(EGG, padding, scale, backwards=manner == "backwards"), 0
        headings = headings + (math.pi if manner == "backwards" else 0.0)
    points = np.random.default_rng(1).uniform((-0.5, -1.6), (2.2, 1.6), (250, 2))
    cells = np.floor((points - table.origin) / table.cell).astype(int)
    inside = (cells >= 0).all(axis=1) & (cells < table.bitmaps.shape[2:0:-1]).all(axis=1)
    met = np.zeros((len(points), 343), bool)
    met[inside] = is_met(table.bitmaps[layer][cells[inside, 1], cells[inside, 0]])
    gap = clearances(points, scale, headings, EGG)
    assert met[gap < padding - 1e-3].all(), "what the padded footprint meets is blocked"
    corner = 0.5 * table.slack  # the edges' distance is a lower bound: at a corner the padding is a mitre
    assert not met[gap > padding + table.slack + corner].any(), "what it passes clearly is not"
    assert 0.02 < met.mean() < 0.6


def test_the_scoring_agrees_with_numpy() -> None:
    rng = np.random.default_rng(5)
    table, library = following_table(DIFF.footprint, 0.03, 0.9), primitive_library()
    points, levels = rng.uniform(-3.0, 3.0, (40, 2)), rng.integers(0, 3, 40).astype(np.uint8)
    may, bearing, reach = rng.random(36) < 0.7, 0.4, 2.5
    blocked = np.zeros((LEVELS, 36, WORDS), np.uint64)
    block_paths(
        points, levels, reach, np.cos(ANGLES), np.sin(ANGLES), may, table.bitmaps, table.origin, table.cell, blocked
    )
    weights = rng.uniform(0.5, 2.0, (36, 7))
    plan = np.array([math.radians(50.0), 0.5, 0.15])
    scores, free = np.empty((36, 7)), np.empty((36, 7), np.int64)
    score_groups(blocked, may, bearing, ANGLES, weights, library.end_directions, library.groups, plan, scores, free)
    for d, angle in enumerate(ANGLES):
        met = np.zeros((LEVELS, 343), bool)
        for point, level in zip(points, levels, strict=True):
            turned = SE2(0.0, 0.0, -angle).transform(point[None])[0]
            ix, iy = np.floor((turned - table.origin) / table.cell).astype(int)
            is_inside = 0 <= iy < table.bitmaps.shape[1] and 0 <= ix < table.bitmaps.shape[2]
            if may[d] and np.hypot(*point) <= reach and is_inside:
                met[level] |= is_met(table.bitmaps[0, iy, ix])
        np.testing.assert_array_equal(is_met(blocked[:, d]), met)
        off = np.abs(wrap(bearing - library.end_directions - angle))
        score = np.maximum(0.0, 1.0 - (off / plan[0]) ** 0.25) * weights[d][library.groups]
        score *= np.where(met[2], plan[2], np.where(met[1], plan[1], 1.0)) * ~met[0] * may[d]
        np.testing.assert_allclose(scores[d], np.bincount(library.groups, score, 7), atol=1e-9)
        assert free[d].sum() == (~met[0]).sum() * may[d]


# Choices


def chooser(model: RobotModel, world: World, at: SE2, **changes: object) -> tuple[PrimitiveChooser, LocalWindow]:
    window = LocalWindow(model, 0.03)
    window.update(*world.window(at.x, at.y, 6.0))
    return PrimitiveChooser(replace(PrimitivesConfig(), **changes), model, window), window


NOTHING = np.empty((0, 2))


def test_a_long_robot_passes_where_a_disc_of_its_length_would_not() -> None:
    """A gap of 0.75 m; the robot is 0.5 m wide, and 1.1 m long."""
    world = World().block(1.5, -3.0, 1.7, -0.375).block(1.5, 0.375, 1.7, 3.0)
    pick, _ = chooser(SPOT, world, SE2())
    choice = pick.choose(SE2(), (4.0, 0.0), 1.0, NOTHING)
    assert choice is not None
    assert choice.manner is Manner.FORWARD
    assert abs(choice.direction) < 0.2
    narrow = World().block(1.5, -3.0, 1.7, -0.25).block(1.5, 0.25, 1.7, 3.0)
    pick, _ = chooser(SPOT, narrow, SE2())
    choice = pick.choose(SE2(), (4.0, 0.0), 1.0, NOTHING)
    assert choice is None or abs(choice.direction) > 0.3, "0.5 m are too narrow for it"


def test_a_robot_beside_walls_does_not_turn_into_them() -> None:
    """In a corridor of 0.9 m a robot of 1.1 m cannot turn: it slides back rather than turn round. In an open place it turns."""
    corridor = World().block(-6.0, 0.45, 6.0, 0.6).block(-6.0, -0.6, 6.0, -0.45)
    pick, _ = chooser(SPOT, corridor, SE2())
    choice = pick.choose(SE2(), (-4.0, 0.0), 1.0, NOTHING)
    assert choice is not None
    assert choice.manner is Manner.HOLDING
    assert abs(wrap_angle(choice.direction - math.pi)) < 0.2
    pick, _ = chooser(SPOT, World(), SE2())
    free = pick.choose(SE2(), (-4.0, 0.0), 1.0, NOTHING)
    assert free is not None
    assert free.manner is Manner.FORWARD


def test_two_way_drive_backs_to_what_lies_behind() -> None:
    pick, _ = chooser(DIFF, World(), SE2())
    choice = pick.choose(SE2(), (-4.0, 0.0), 1.0, NOTHING)
    assert choice is not None
    assert choice.manner is Manner.FORWARD
    pick, _ = chooser(DIFF, World(), SE2(), is_two_way=True)
    choice = pick.choose(SE2(), (-4.0, 0.3), 1.0, NOTHING)
    assert choice is not None
    assert choice.manner is Manner.BACKWARDS
    log = drive(
        MotionPrimitives(replace(PrimitivesConfig(), is_two_way=True), DIFF), DIFF, World(), line((0, 0), (-3, 0), yaw=0.0), SE2()
    )  # fmt: skip
    assert log.is_reached
    assert max(abs(pose.yaw) for pose in log.poses) < 0.5


def test_slow_robots_look_less_far() -> None:
    """A wall 2.2 m ahead blocks the long straight paths of a fast robot, not those of a slow one."""
    world = World().block(2.4, -3.0, 2.6, 3.0)
    pick, _ = chooser(DIFF, world, SE2())
    pick.choose(SE2(), (6.0, 0.0), 1.0, NOTHING)
    fast = pick.free_paths
    slow = pick.choose(SE2(), (6.0, 0.0), 0.3, NOTHING)
    assert slow is not None
    assert abs(slow.direction) < 0.2
    assert pick.free_paths > fast


def rough_window(y_free: float) -> tuple[np.ndarray, GridSpec]:
    """Ground that is very rough ahead, but for what lies to the left of `y_free`."""
    spec = GridSpec(0.05, 120, 120, -3.0, -3.0)
    costs = np.zeros(spec.shape, np.uint8)
    costs[: spec.cell_of(0.0, y_free)[0], spec.cell_of(0.6, 0.0)[1] :] = 80
    return costs, spec


def test_rough_ground_is_avoided_where_there_is_better_and_crossed_slowly_where_there_is_none() -> None:
    def command(y_free: float) -> tuple[BodyVelocity, MotionPrimitives]:
        planner = MotionPrimitives(PrimitivesConfig(), DIFF)
        planner.set_path(line((0, 0), (5, 0)))
        costs, spec = rough_window(y_free)
        v, pose = BodyVelocity(0.5), SE2()
        for _ in range(12):
            v = planner.compute_command(costs, spec, pose, v)
        return v, planner

    across, planner = command(3.0)
    assert planner.state is LocalState.SLOWED
    assert "rough" in planner.reason
    assert 0.05 < across.vx < 0.3
    beside, planner = command(-0.05)
    assert planner.state is not LocalState.SLOWED
    assert beside.wz > 0.1, "it bears off to where the ground is smooth"
    assert beside.vx > 0.4


def test_a_mover_that_will_be_met_is_driven_around() -> None:
    def direction(states: np.ndarray) -> float:
        planner = MotionPrimitives(PrimitivesConfig(), DIFF)
        planner.set_path(line((0, 0), (5, 0)))
        planner.set_movers(Movers(0, states))
        planner.compute_command(*World().window(0.0, 0.0, 6.0), SE2(), BodyVelocity(0.5))
        x, y, _ = planner.trajectory[-1]
        return math.atan2(y, x)

    coming = np.array([[2.6, -0.1, -0.8, 0.0, -0.8, 0.0]])
    leaving = np.array([[2.6, -0.1, 1.5, 0.0, 1.5, 0.0]])
    assert abs(direction(leaving)) < 0.05
    assert abs(direction(coming)) > 0.15


# The follower


def follower(model: RobotModel, **changes: float) -> PathFollower:
    window = LocalWindow(model, 0.03)
    window.update(*World().window(0.0, 0.0, 6.0))
    return PathFollower(replace(FollowerConfig(), **changes), model, window)


@pytest.mark.parametrize("robot", ROBOTS)
def test_commands_keep_to_the_accelerations_of_the_robot(robot: str) -> None:
    model, rng = ROBOTS[robot], np.random.default_rng(2)
    follow, v, lim = follower(model), BodyVelocity(), ROBOTS[robot].limits
    for _ in range(300):
        end = rng.uniform(-2.0, 2.0, 2)
        path = np.linspace((0.0, 0.0), end, 20)
        holds = robot == "spot" and rng.random() < 0.5
        now = follow.follow(path, SE2(), v, float(rng.uniform(0.1, 0.8)), holds=holds)
        assert now is not None
        for value, before, up, down in (
            (now.vx, v.vx, lim.ax_max, lim.ax_brake),
            (now.vy, v.vy, lim.ay_max, lim.ay_brake),
            (now.wz, v.wz, lim.az_max, lim.az_max),
        ):
            assert abs(value - before) <= 0.05 * max(up, down) + 1e-9
            assert abs(value) - abs(before) <= 0.05 * up + 1e-9
        v = now


def test_the_stop_zone_ends_before_a_wall_whatever_the_path_says() -> None:
    world, v, pose = World().block(1.5, -3.0, 1.7, 3.0), BodyVelocity(), SE2()
    window = LocalWindow(DIFF, 0.03)
    follow, path, stopped = PathFollower(FollowerConfig(), DIFF, window), np.linspace((0.0, 0.0), (3.0, 0.0), 60), False
    for _ in range(120):
        window.update(*world.window(pose.x, pose.y, 5.0))
        command = follow.follow(path, pose, v, 0.8)
        stopped = command is None
        v = BodyVelocity() if command is None else command
        pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * 0.05)
        assert not world.touches(DIFF, pose)
    assert stopped
    assert 1.3 < pose.x + 0.25 < 1.5


def test_a_base_that_was_held_does_not_go_on_where_it_left_off() -> None:
    follow, path = follower(DIFF), np.linspace((0.0, 0.0), (3.0, 0.0), 20)
    for _ in range(40):
        fast = follow.follow(path, SE2(), BodyVelocity(0.8), 0.8)
    assert fast is not None
    assert fast.vx > 0.7
    held = follow.follow(path, SE2(), BodyVelocity(), 0.8)
    assert held is not None
    assert held.vx < 0.3


def test_a_lean_slows_and_stops_and_its_rate_slows() -> None:
    def speed(lean: Lean, seconds_after: float = 0.0) -> float:
        planner = MotionPrimitives(PrimitivesConfig(), DIFF)
        planner.set_path(line((0, 0), (5, 0)))
        v = BodyVelocity()
        for k in range(40 + round(seconds_after / 0.05)):
            planner.set_lean(lean if k < 40 else Lean())
            v = planner.compute_command(*World().window(0.0, 0.0, 6.0), SE2(), v)
        if v == BodyVelocity():
            assert planner.state is LocalState.LEANING
        return v.vx

    level, steep = speed(Lean(0.0, math.radians(15.0))), speed(Lean(0.0, math.radians(24.0)))
    assert level > 0.7, "a ramp of 15° is nothing special"
    assert 0.3 < steep < 0.45
    assert speed(Lean(math.radians(-35.0), 0.0)) == 0.0
    assert speed(Lean(math.radians(-35.0), 0.0), 4.0) == 0.0, "it stands for 5 s after"
    assert speed(Lean(math.radians(-35.0), 0.0), 7.0) > 0.5
    assert speed(Lean(0.0, 0.0, 0.0, 3.0)) < 0.3


# Dead ends


def pocket(depth: float, half: float, wall: float = 0.2) -> World:
    """A U of walls that opens against the x axis, its bottom at x = depth."""
    world = World(24.0).block(depth, -half - wall, depth + wall, half + wall)
    return world.block(0.0, half, depth, half + wall).block(0.0, -half - wall, depth, -half)


class Patient:
    """A planner whose failures are stood through, as the controller node does for a while."""

    def __init__(self, planner: MotionPrimitives) -> None:
        self.planner = planner
        self.states: list[LocalState] = []

    def __getattr__(self, name: str) -> object:
        return getattr(self.planner, name)

    def compute_command(self, *inputs: object) -> BodyVelocity:
        try:
            command = self.planner.compute_command(*inputs)  # type: ignore[arg-type]
        except NoValidControlError:
            command = BodyVelocity()
        self.states.append(self.planner.state)
        return command


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("depth", "half"), [(2.0, 1.0), (3.0, 1.0), (3.0, 1.5), (4.0, 1.5)])
@pytest.mark.parametrize("is_inside", [True, False])
def test_it_leaves_a_pocket_and_reaches_a_way_point_behind_it(
    robot: str, depth: float, half: float, *, is_inside: bool
) -> None:
    """The path is a straight line to a way-point 10 m away; nobody tells the planner of the pocket, and its window shows 3 m."""
    model = ROBOTS[robot]
    x = depth - 0.8 if is_inside else -1.0
    world, patient, log = pocket(depth, half), Patient(MotionPrimitives(PrimitivesConfig(), model)), Drive()
    drive(patient, model, world, line((x, 0), (10, 0)), SE2(x, 0.0, 0.0), 45.0, window=6.0, log=log)  # type: ignore[arg-type]
    assert log.is_reached
    assert log.collisions == 0
    inside = [0.0 < pose.x < depth and abs(pose.y) < half for pose in log.poses]
    if is_inside:
        assert 0.05 * sum(inside) < 10.0, "it is out within 10 s"
        assert LocalState.BLOCKED in patient.states
        assert LocalState.LEAVING_DEAD_END in patient.states
    else:
        assert 0.05 * sum(inside) < 14.0, "in and out again"


def test_a_dead_end_that_opens_is_forgotten() -> None:
    wall = World().block(1.2, -3.0, 1.4, 3.0)
    planner = MotionPrimitives(PrimitivesConfig(), DIFF)
    planner.set_path(line((0.5, 0), (5, 0)))
    for _ in range(12):
        with suppress(NoValidControlError):
            planner.compute_command(*wall.window(0.5, 0.0, 4.0), SE2(0.5, 0.0, 0.0), BodyVelocity())
    assert len(planner._memory.places) == 1
    planner.compute_command(*World().window(0.5, 0.0, 4.0), SE2(0.5, 0.0, 0.0), BodyVelocity())
    assert planner._memory.places == []


def test_places_cost_more_each_time_and_are_forgotten_in_time() -> None:
    memory = DeadEnds(1.0, 8.0, 60.0)
    memory.add(SE2(2.0, 0.0, 0.0), (3.0, 0.0), 10.0)
    here, beyond = np.array([[2.0, 0.0]]), np.array([[2.0, 2.1]])
    once = memory.cost(here)[0]
    memory.add(SE2(2.3, 0.2, 0.0), (3.0, 0.0), 20.0)
    assert len(memory.places) == 1
    assert memory.cost(here)[0] == pytest.approx(2.0 * once)
    assert memory.cost(beyond)[0] == 0.0
    assert memory.covers(np.array([[3.5, 0.0], [0.5, 0.0]])).tolist() == [True, False]
    memory.forget(79.0)
    assert memory.places
    memory.forget(81.0)
    assert memory.places == []


# Goals, states, steering


@pytest.mark.parametrize("robot", ROBOTS)
def test_nothing_is_compiled_while_it_drives(robot: str) -> None:
    for module in (primitives, footprint, rollout, arc):
        module.warm_up()
    before = warmup.compiled_signatures()
    planner = MotionPrimitives(PrimitivesConfig(), ROBOTS[robot])
    planner.set_movers(Movers(0, np.array([[2.6, -0.1, -0.8, 0.0, -0.8, 0.0]])))
    drive(planner, ROBOTS[robot], World().block(2.0, -0.2, 2.3, 0.1), line((0, 0), (4, 0)), SE2(), 10.0, window=6.0)
    after = warmup.compiled_signatures()
    names = [name for name in after if name.partition(".")[0] in {"primitives", "footprint", "rollout", "arc"}]
    assert {name: after[name] for name in names} == {name: before[name] for name in names}


def test_it_says_what_it_does_and_why_it_stands() -> None:
    planner = MotionPrimitives(PrimitivesConfig(), DIFF)
    assert planner.state is LocalState.IDLE
    patient = Patient(planner)
    drive(patient, DIFF, World(), line((0, 0), (1, 0), (1, 1), yaw=0.0), SE2(), 20.0, 0.05, 0.05)  # type: ignore[arg-type]
    assert LocalState.DRIVING in patient.states
    assert LocalState.TURNING in patient.states
    planner.compute_command(*World().window(1.0, 1.0, 5.0), SE2(1.0, 1.0, 0.0), BodyVelocity())
    assert planner.state is LocalState.GOAL_REACHED
    planner.set_path(line((1, 1), (-3, 1)))
    planner.compute_command(*World().window(1.0, 1.0, 5.0), SE2(1.0, 1.0, 0.0), BodyVelocity())
    assert planner.state is LocalState.FROZEN, "a new goal behind it may be a mistake"
    for _ in range(8):
        planner.compute_command(*World().window(1.0, 1.0, 5.0), SE2(1.0, 1.0, 0.0), BodyVelocity())
    assert planner.state is LocalState.TURNING


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_person_steers_around_a_box_and_up_to_a_wall(robot: str) -> None:
    model = ROBOTS[robot]
    world = World().block(2.0, -0.3, 2.4, 0.3).block(5.0, -4.0, 5.2, 4.0)
    planner, pose, v = MotionPrimitives(PrimitivesConfig(), model), SE2(), BodyVelocity()
    aside, speeds, stops = 0.0, [], 0
    for _ in range(400):
        ahead = BodyVelocity(
            0.5 * math.cos(pose.yaw), -0.5 * math.sin(pose.yaw)
        )  # the stick points along the x axis of odom
        try:
            v = planner.steer(*world.window(pose.x, pose.y, 6.0), pose, v, ahead)
        except NoValidControlError:
            v, stops = BodyVelocity(), stops + 1
        pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * 0.05)
        assert not world.touches(model, pose)
        aside = max(aside, abs(pose.y))
        speeds.append(math.hypot(v.vx, v.vy))
    assert aside > 0.3
    assert pose.x > 3.0, "it has passed the box"
    assert max(speeds) < 0.51, "no faster than the person wants"
    still = planner.steer(*world.window(pose.x, pose.y, 6.0), pose, BodyVelocity(), BodyVelocity())
    assert abs(still.vx) < 0.1


def test_a_person_turns_it_in_place() -> None:
    planner, v = MotionPrimitives(PrimitivesConfig(), DIFF), BodyVelocity()
    for _ in range(10):
        v = planner.steer(*World().window(0.0, 0.0, 5.0), SE2(), v, BodyVelocity(0.0, 0.0, -0.4))
    assert v.vx == 0.0
    assert v.wz == pytest.approx(-0.4)
