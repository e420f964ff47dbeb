"""Several robots in one world: stepped once for all, seen and touched by each other, each with chance of its own."""

from __future__ import annotations

import math
import threading
from dataclasses import fields, replace

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.devices import RobotDevices
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.camera import CameraSpec
from ambler.sim.dock_body import marker_poses
from ambler.sim.faults import Fault
from ambler.sim.ground_truth import GroundTruth
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named
from ambler.sim.solids import Person, WorldSpec
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world

FLOOR = WorldSpec("floor", (), SE2(5.0, -2.0, 0.5))
MS = 1_000_000
PERFECT = SimulationConfig(is_perfect=True, physics="kinematic")


class Robot:
    """The open devices of one robot of a world, and its ground truth."""

    def __init__(self, world: World, name: str) -> None:
        self.body, self.devices = world.body(name), robot_devices(world, name)
        self.truth = GroundTruth(world, self.body)
        d: RobotDevices = self.devices
        assert d.battery is not None
        for device in (d.base, *d.lidars, *d.imus, *d.ranges, *d.cameras, d.battery, self.truth):
            device.open()

    def poses(self, now_ns: int) -> list[m.Odometry]:
        return [t for t in self.truth.read(now_ns) if isinstance(t, m.Odometry)]

    def contacts(self, now_ns: int) -> list[m.Contact]:
        return [t for t in self.truth.read(now_ns) if isinstance(t, m.Contact)]


def pair(
    away: SE2, config: SimulationConfig = PERFECT, kinds: tuple[str, str] = ("diff", "diff"), **second: object
) -> tuple[World, Robot, Robot]:
    """Robot `a` at the start, `b` at a pose in its frame; the world has begun at 0."""
    specs = [
        BodySpec("a", robot_named(kinds[0])),
        BodySpec("b", robot_named(kinds[1]), FLOOR.start @ away, **second),  # type: ignore[arg-type]
    ]
    world = World(FLOOR, specs, config)
    a, b = Robot(world, "a"), Robot(world, "b")
    world.advance(0)
    return world, a, b


@pytest.mark.parametrize("away", [SE2(3.0, 0.0, 0.0), SE2(-2.0, 1.5, 0.8)])
def test_robots_see_each_other_where_they_are_and_never_themselves(away: SE2) -> None:
    _, a, b = pair(away)
    for seer, seen, place in ((a, b, away), (b, a, away.inverse())):
        (scan,) = seer.devices.lidars[0].read(200 * MS)
        assert isinstance(scan, m.LaserScan)
        hits = np.flatnonzero(np.isfinite(scan.ranges))
        angles = scan.angle_min + hits * scan.angle_increment
        points = np.array([0.08, 0.0]) + scan.ranges[hits, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        local = place.inverse().transform(points)
        half = seen.body.robot.model.footprint.max(axis=0)
        beyond = (np.abs(local) - half).max(axis=1)
        assert len(hits) > 8, "it covers some beams"
        np.testing.assert_allclose(beyond, 0.0, atol=2e-3, err_msg="every return lies on the other robot's outline")
        bearing = math.atan2(place.y, place.x - 0.08)
        assert np.cos(angles - bearing).min() > math.cos(0.3)


def test_a_moving_robot_is_seen_where_it_was_at_each_beam() -> None:
    world, a, b = pair(SE2(2.0, -0.6, math.pi / 2))
    for k in range(100):
        b.devices.base.command(BodyVelocity(0.6, 0.0, 0.0))
        world.advance((k + 1) * 10 * MS)
    scan = list(a.devices.lidars[0].read(1000 * MS))[-1]
    assert isinstance(scan, m.LaserScan)
    for k in np.flatnonzero(np.isfinite(scan.ranges)):
        angle = scan.angle_min + k * scan.angle_increment
        x, y = 0.08 + scan.ranges[k] * math.cos(angle), scan.ranges[k] * math.sin(angle)
        fired_ns = scan.stamp_ns + round(k * scan.time_increment * 1e9)
        there = FLOOR.start.inverse() @ b.body.pose_at(fired_ns).to_se2()
        local = (there.inverse() @ SE2(x, y, 0.0)).as_array()[:2]
        assert (np.abs(local) - [0.25, 0.2]).max() == pytest.approx(0.0, abs=3e-3)


@pytest.mark.parametrize("physics", ["contact", "kinematic"])
@pytest.mark.parametrize("kinds", [("diff", "diff"), ("spot", "diff"), ("amr_omni", "spot")])
def test_a_bump_is_reported_to_both_by_the_others_name(kinds: tuple[str, str], physics: str) -> None:
    config = SimulationConfig(physics="contact" if physics == "contact" else "kinematic")
    world, a, b = pair(SE2(1.6, 0.0, 0.0), config, kinds)
    for k in range(300):
        a.devices.base.command(BodyVelocity(0.5, 0.0, 0.0))
        world.advance((k + 1) * 10 * MS)
    told_a, told_b = a.contacts(3000 * MS), b.contacts(3000 * MS)
    assert {c.other_geom for c in told_a} == {"b"}
    assert {c.other_geom for c in told_b} == {"a"}
    assert told_a[0].stamp_ns == told_b[0].stamp_ns
    assert told_a[0].speed > 0.3
    assert told_b[0].speed < 0.05, "it stood when it was hit"
    moved = b.body.start.inverse() @ b.body.world_from_base.to_se2()
    if physics == "contact":
        assert moved.x > 0.05, "it was pushed"
    else:
        assert b.body.world_from_base.to_se2().distance_to(b.body.start) < 1e-9


@pytest.mark.parametrize("physics", ["contact", "kinematic"])
def test_each_body_starts_where_it_is_put_and_obeys_its_own_commands(physics: str) -> None:
    config = SimulationConfig(is_perfect=True, physics="contact" if physics == "contact" else "kinematic")
    world, a, b = pair(SE2(0.0, 4.0, 2.0), config, ("diff", "amr_omni"))
    for k in range(200):
        a.devices.base.command(BodyVelocity(0.4, 0.0, 0.3))
        b.devices.base.command(BodyVelocity(0.0, -0.3, 0.0))
        world.advance((k + 1) * 10 * MS)
    for robot, twist in ((a, (0.4, 0.0, 0.3)), (b, (0.0, -0.3, 0.0))):
        truth = robot.poses(2000 * MS)
        assert (truth[0].frame, truth[0].child) == ("world", "base")
        assert truth[0].pose.to_se2().distance_to(robot.body.start) < 1e-9
        assert robot.truth.start_pose(0).pose.to_se2().distance_to(robot.body.start) == 0.0
        reached = (*truth[-1].linear[:2], truth[-1].angular[2])
        np.testing.assert_allclose(reached, twist, atol=0.02)
        odometry = list(robot.devices.base.read(2000 * MS))
        went = robot.body.start.inverse() @ truth[-1].pose.to_se2()
        assert odometry[0].pose.to_se2().distance_to(SE2()) < 1e-9
        assert odometry[-1].pose.to_se2().distance_to(went) < 0.05


def everything(world: World, robot: Robot, seconds: float) -> list[bytes]:
    """The bits of all that a robot's devices tell while it drives a curve, read in steps of 10 ms."""
    d, out = robot.devices, []
    assert d.battery is not None
    for k in range(1, round(seconds * 100) + 1):
        now_ns = k * 10 * MS
        d.base.command(BodyVelocity(0.3, 0.0, 0.2))
        for device in (d.base, *d.lidars, *d.imus, *d.ranges, d.battery, robot.truth):
            for message in device.read(now_ns):
                for f in fields(message):
                    value = getattr(message, f.name)
                    out.append(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return out


def run(config: SimulationConfig, *others: BodySpec, kind: str = "diff+ultrasonic") -> list[bytes]:
    world = World(load_world("lab_obstacle"), [BodySpec("a", robot_named(kind)), *others], config)
    robot = Robot(world, "a")
    world.advance(0)
    return everything(world, robot, 1.2)


@pytest.mark.parametrize("physics", ["contact", "kinematic"])
def test_equal_runs_are_equal_to_the_bit(physics: str) -> None:
    config = SimulationConfig(3, physics="contact" if physics == "contact" else "kinematic")
    other = BodySpec("b", robot_named("spot"), load_world("lab_obstacle").start @ SE2(2.5, 0.5, 1.0))
    first = run(config, other)
    assert first == run(config, other)
    assert first != run(replace(config, seed=4), other)


def test_a_robot_out_of_sight_changes_nothing_for_another() -> None:
    config = SimulationConfig(3, physics="kinematic")
    far = BodySpec("b", robot_named("amr_omni"), SE2(-60.0, -60.0, 0.0))
    assert run(config) == run(config, far)
    near = replace(far, start=load_world("lab_obstacle").start @ SE2(2.0, 0.8, 0.0))
    assert run(config) != run(config, near)


def test_robots_of_one_kind_have_chance_of_their_own() -> None:
    config = SimulationConfig(3, physics="kinematic")
    world, a, b = pair(SE2(0.0, 50.0, 0.0), config)
    world.advance(500 * MS)
    noise = [[i.angular_velocity for i in r.devices.imus[0].read(500 * MS)] for r in (a, b)]
    assert len(noise[0]) == len(noise[1]) == 50
    assert not set(noise[0]) & set(noise[1])
    same, c, d = pair(SE2(0.0, 50.0, 0.0), config, seed=3)
    same.advance(500 * MS)
    twins = [[i.angular_velocity for i in r.devices.imus[0].read(500 * MS)] for r in (c, d)]
    assert twins[0] == noise[0]
    np.testing.assert_allclose(twins[1], twins[0], atol=1e-9, err_msg="a seed of one's own decides")


def test_whoever_asks_first_advances_the_world_and_the_others_find_it_done() -> None:
    world, a, b = pair(SE2(3.0, 0.0, 0.0), SimulationConfig(1, physics="kinematic"))
    ticks: list[int] = []
    step = world._physics.step
    world._physics.step = lambda targets: (ticks.append(world.elapsed_ns), step(targets))[1]  # type: ignore[method-assign]
    for robot in (a, b, a):
        robot.devices.base.read(100 * MS)
        assert len(ticks) == 20
        assert world.now_ns == 100 * MS
    world.advance(50 * MS)
    world.advance(104 * MS)
    assert (len(ticks), world.now_ns) == (20, 100 * MS), "time never goes back, and only in whole ticks"
    world.advance(105 * MS)
    assert len(ticks) == 21


def test_many_threads_may_ask_at_once() -> None:
    quiet, alone, _ = pair(SE2(3.0, 0.0, 0.0), SimulationConfig(1, physics="kinematic"))
    quiet.advance(1000 * MS)
    wanted = [(i.stamp_ns, i.angular_velocity) for i in alone.devices.imus[0].read(1000 * MS)]
    _, a, b = pair(SE2(3.0, 0.0, 0.0), SimulationConfig(1, physics="kinematic"))
    told: list[m.Imu] = []

    def ask(device: object, out: list[m.Imu]) -> None:
        for k in range(1, 201):
            out.extend(device.read(k * 5 * MS))  # type: ignore[attr-defined]

    devices = [a.devices.imus[0], b.devices.imus[0], a.devices.base, b.devices.lidars[0]]
    threads = [threading.Thread(target=ask, args=(d, told if k == 0 else [])) for k, d in enumerate(devices)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [(i.stamp_ns, i.angular_velocity) for i in told] == wanted


def test_faults_of_one_robot_leave_the_other_alone() -> None:
    fault = (Fault.parse("scanner_dropout"),)
    world, a, b = pair(SE2(3.0, 0.0, 0.0), faults=fault)
    world.advance(1000 * MS)
    assert len(a.devices.lidars[0].read(1000 * MS)) == 9
    assert len(b.devices.lidars[0].read(1000 * MS)) == 0
    assert b.devices.lidars[0].health().lost == 10
    with pytest.raises(BadInputError, match="whole world"):
        pair(SE2(3.0, 0.0, 0.0), faults=(Fault.parse("people"),))


def test_names_must_tell_robots_apart() -> None:
    diff = robot_named("diff")
    for names in (("a", "a"), ("a", "b/c"), ("", "b")):
        with pytest.raises(BadInputError, match="name"):
            World(FLOOR, [BodySpec(name, diff) for name in names], PERFECT)
    world, _, _ = pair(SE2(3.0, 0.0, 0.0))
    with pytest.raises(KeyError, match="'c'"):
        world.body("c")


def test_people_halt_before_every_robot() -> None:
    lane = Person("person_0", ((3.0, 0.0), (-3.0, 0.0)), speed=1.0, yields=True)
    spec = WorldSpec("lane", (), SE2(0.0, 20.0, 0.0), people=(lane,))
    specs = [BodySpec("a", robot_named("diff")), BodySpec("b", robot_named("diff"), SE2(0.0, 0.0, 0.0))]
    world = World(spec, specs, PERFECT)
    b = Robot(world, "b")
    world.advance(0)
    walker, gaps = world.crowd.walkers[0], []
    for k in range(1500):
        world.advance((k + 1) * 20 * MS)
        gaps.append(abs(walker.position[0]) - 0.25 - 0.25)
    assert min(gaps[100:]) == pytest.approx(0.5, abs=0.03)
    assert b.contacts(30_000 * MS) == []


@pytest.mark.parametrize(("beside", "is_hidden"), [(0.0, True), (1.5, False)])
def test_a_robot_between_hides_the_markers_of_a_dock(beside: float, is_hidden: bool) -> None:
    spec = load_world("dock_room")
    dock = spec.docks[0]
    robot = robot_named("amr_omni")
    robot = replace(robot, cameras={"camera": CameraSpec(samples=1)})
    tall = robot_named("spot")
    specs = [
        BodySpec("a", robot, dock.world_from_dock @ SE2(-3.0, 0.0, 0.0)),
        BodySpec("b", tall, dock.world_from_dock @ SE2(-1.2, beside, math.pi / 2)),
    ]
    world = World(spec, specs, PERFECT)
    a = Robot(world, "a")
    world.advance(0)
    a.devices.cameras[0].request(100 * MS)
    world.advance(100 * MS)
    picture = a.devices.cameras[0].read(200 * MS)[0]
    model = a.devices.cameras[0].model
    camera = a.body.world_from_base @ a.body.mounts["camera"]
    center = camera.inverse() @ marker_poses(dock)[0]
    x, y, z = center.translation
    column, row = round(model.cx + model.fx * x / z), round(model.cy + model.fy * y / z)
    patch = picture.data[row - 8 : row + 9, column - 8 : column + 9].astype(float)
    assert bool(patch.std() < 15.0) is is_hidden, "a marker has black and white cells"
