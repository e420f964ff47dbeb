"""Bases under contact physics and in the cheap mode: they go where they are told, slip when they must, and stop at walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import Contact
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.base import PlacedRobot
from ambler.sim.body import TICK
from ambler.sim.contact_physics import ContactPhysics
from ambler.sim.kinematic_physics import FootprintCollider, circle_overlaps, polygons_overlap
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec

MODES = ("contact", "kinematic")


def simulate(world: WorldSpec, robot: str, mode: str, is_perfect: bool = True) -> Simulation:
    config = SimulationConfig(3, is_perfect, "contact" if mode == "contact" else "kinematic")
    return Simulation(world, robot_named(robot), config)


def drive(simulation: Simulation, command: BodyVelocity, seconds: float) -> list[Contact]:
    """Drive with a command renewed at 20 Hz; returns the contacts."""
    contacts = []
    for _ in range(round(seconds * 20)):
        simulation.command(command)
        contacts += simulation.step(simulation.now_ns + 50_000_000).contacts
    return contacts


def velocity(simulation: Simulation) -> tuple[float, float, float]:
    """True mean velocity of the carriage over one gait cycle (0.8 s), in its frame at the start of it."""
    before = simulation.world_from_base.to_se2()
    out = simulation.step(simulation.now_ns + 800_000_000)
    assert out.true_poses
    twist = (before.inverse() @ simulation.world_from_base.to_se2()).log() / 0.8
    return float(twist[0]), float(twist[1]), float(twist[2])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("robot", "command"),
    [
        ("diff", BodyVelocity(0.6, 0.0, 0.0)),
        ("diff", BodyVelocity(0.0, 0.0, 1.0)),
        ("diff", BodyVelocity(0.5, 0.0, -0.7)),
        ("diff", BodyVelocity(-0.3, 0.0, 0.2)),
        ("spot", BodyVelocity(0.6, 0.3, 0.4)),
        ("spot", BodyVelocity(0.0, -0.3, 0.0)),
    ],
)
def test_the_commanded_velocity_is_reached(open_floor: WorldSpec, robot: str, command: BodyVelocity, mode: str) -> None:
    simulation = simulate(open_floor, robot, mode)
    simulation = Simulation(open_floor, replace(simulation.robot, watchdog=10.0), simulation.config)
    drive(simulation, command, 2.0)
    np.testing.assert_allclose(velocity(simulation), (command.vx, command.vy, command.wz), atol=0.02)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("is_cut_off", [False, True], ids=["told to stop", "told nothing any more"])
def test_a_base_stops_as_hard_as_it_can(open_floor: WorldSpec, robot: str, mode: str, is_cut_off: bool) -> None:
    simulation = simulate(open_floor, robot, mode)
    drive(simulation, BodyVelocity(0.6, 0.0, 0.0), 1.5)
    begin = simulation.world_from_base.to_se2()
    if not is_cut_off:
        simulation.command(BodyVelocity())
    simulation.step(simulation.now_ns + 2_000_000_000)
    way = (begin.inverse() @ simulation.world_from_base.to_se2()).x
    noticed = simulation.robot.watchdog - 0.05 if is_cut_off else 0.0  # the last command is 50 ms old
    assert way == pytest.approx(0.6 * noticed + 0.6**2 / (2.0 * simulation.robot.model.limits.ax_stop), abs=0.02)


@pytest.mark.parametrize("robot", robot_names())
def test_friction_limits_acceleration(open_floor: WorldSpec, robot: str) -> None:
    """On ice (mu = 0.05) no base can accelerate faster than mu g, whatever its wheels or feet do."""
    ice = replace(open_floor, friction=0.05)
    physics = ContactPhysics(ice, [PlacedRobot("robot", robot_named(robot), SE2())], TICK)
    speeds = []
    for _ in range(100):
        x = physics.carriage(0).position[0]
        physics.step([BodyVelocity(0.8, 0.0, 0.0)])
        speeds.append((physics.carriage(0).position[0] - x) / TICK)
    gained = (speeds[-1] - speeds[9]) / (90 * TICK)
    assert gained <= 0.05 * 9.81 * 1.05
    assert speeds[-1] > 0.1


def test_wheels_that_slip_count_more_than_the_base_moves(open_floor: WorldSpec) -> None:
    odometry = []
    for friction in (0.8, 0.05):
        simulation = simulate(replace(open_floor, friction=friction), "diff", "contact")
        drive(simulation, BodyVelocity(0.8, 0.0, 0.0), 1.0)
        counted = simulation.step(simulation.now_ns + 20_000_000).odometry[-1].pose.translation[0]
        odometry.append(counted - simulation.world_from_base.translation[0])
    assert abs(odometry[0]) < 0.01
    assert odometry[1] > 0.05


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("robot", robot_names())
def test_a_wall_is_touched_and_not_passed(wall_ahead: WorldSpec, robot: str, mode: str) -> None:
    simulation = simulate(wall_ahead, robot, mode)
    front = float(simulation.robot.model.footprint[:, 0].max())
    assert drive(simulation, BodyVelocity(0.5, 0.0, 0.0), 4.0) == []
    contacts = drive(simulation, BodyVelocity(0.5, 0.0, 0.0), 4.0)
    assert {(c.robot_geom, c.other_geom) for c in contacts} == {("body", "wall")}
    assert contacts[0].speed == pytest.approx(0.5, abs=0.06)
    assert simulation.world_from_base.translation[0] + front < 3.03
    times = [c.stamp_ns for c in contacts]
    assert times == sorted(times)


@pytest.mark.parametrize("robot", robot_names())
def test_standing_still_touches_nothing_and_stays(open_floor: WorldSpec, robot: str) -> None:
    simulation = simulate(open_floor, robot, "contact")
    out = simulation.step(2_000_000_000)
    assert out.contacts == []
    assert np.hypot(*simulation.world_from_base.translation[:2]) < 1e-4


@pytest.mark.parametrize("mode", MODES)
def test_without_commands_the_base_stops_by_itself(open_floor: WorldSpec, mode: str) -> None:
    simulation = simulate(open_floor, "diff", mode)
    drive(simulation, BodyVelocity(0.8, 0.0, 0.0), 2.0)
    simulation.step(simulation.now_ns + 1_300_000_000)
    assert np.hypot(*velocity(simulation)[:2]) < 1e-3


def test_commands_are_clipped_and_garbage_is_a_stop(open_floor: WorldSpec) -> None:
    simulation = simulate(open_floor, "diff", "kinematic")
    drive(simulation, BodyVelocity(9.0, 5.0, 0.0), 2.0)
    x = simulation.world_from_base.translation
    simulation.command(BodyVelocity(9.0, 5.0, 0.0))
    simulation.step(simulation.now_ns + 100_000_000)
    assert (simulation.world_from_base.translation[0] - x[0]) / 0.1 == pytest.approx(0.8)
    assert simulation.world_from_base.translation[1] == 0.0
    drive(simulation, BodyVelocity(math.nan, 0.0, 0.0), 1.0)
    assert np.hypot(*velocity(simulation)[:2]) == 0.0


def test_the_legged_body_sways_while_it_walks_and_not_while_it_stands(open_floor: WorldSpec) -> None:
    simulation = simulate(open_floor, "spot", "contact")
    assert abs(simulation.world_from_base.rotation[1]) < 1e-3
    heights, rolls = [], []
    for _ in range(100):
        drive(simulation, BodyVelocity(0.5, 0.0, 0.0), 0.05)
        pose = simulation.world_from_base
        heights.append(pose.translation[2])
        rolls.append(2 * pose.rotation[1])
    assert 0.018 < np.ptp(heights[40:]) < 0.04
    assert math.radians(2.0) < np.ptp(rolls[40:]) < math.radians(4.0)


def test_polygons_and_circles_overlap_when_they_should() -> None:
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    rng = np.random.default_rng(0)
    for _ in range(200):
        shift = SE2(*rng.uniform(-2, 2, 2), rng.uniform(-3, 3))
        other = shift.transform(square)
        share = rng.uniform(0, 1, (4000, 2))
        seen = shift.inverse().transform(share)
        has_common_point = bool(((seen > 0.01) & (seen < 0.99)).all(axis=1).any())
        if has_common_point:
            assert polygons_overlap(square, other)
        center, radius = rng.uniform(-2, 2, 2), rng.uniform(0.1, 1.0)
        gap = float(np.hypot(*(center - np.clip(center, 0, 1))))
        assert circle_overlaps(center, radius, square) == (gap < radius)
    assert not polygons_overlap(square, square + np.array([1.001, 0.0]))
    assert polygons_overlap(square, square + np.array([0.999, 0.0]))


def test_lintels_above_the_robot_are_no_obstacle() -> None:
    lintel = Solid("lintel", Shape.BOX, SE2(), 1.0, 1.0, 2.1, 2.5)
    collider = FootprintCollider(WorldSpec("gate", (lintel,), SE2()), robot_named("spot"))
    assert collider.overlapping(SE2()) == ()
