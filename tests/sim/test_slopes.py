"""The robots with a Mid-360 on slopes: they climb, halt at kerbs, see the true surface from where they lean, and meet people up there."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import PointCloud
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.base import PlacedRobot
from ambler.sim.body import TICK
from ambler.sim.contact_physics import ContactPhysics
from ambler.sim.movers import Crowd
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Person, Shape, Solid
from ambler.sim.world_file import load_world
from tests.sim.test_ground import drive, lean_deg, slope, steps, travelled


@pytest.mark.parametrize("robot", ["mecanum", "go2", "g1"])
def test_fifteen_degrees_are_climbed(robot: str) -> None:
    physics = ContactPhysics(slope(15.0, "field"), [PlacedRobot("robot", robot_named(robot), SE2())], TICK)
    assert lean_deg(physics) == pytest.approx((0.0, -15.0), abs=0.5)
    steps(physics, BodyVelocity(0.5, 0.0, 0.0), 1.0)
    moved = travelled(physics, BodyVelocity(0.5, 0.0, 0.0), 3.0)
    assert np.linalg.norm(moved) == pytest.approx(1.5, abs=0.03)
    assert moved[2] == pytest.approx(1.5 * math.sin(math.radians(15.0)), abs=0.02)
    assert physics.touches(0) == ()


def test_mecanum_loses_its_grip_where_the_slope_is_steeper_than_its_friction() -> None:
    """tan 15 degrees is 0.27: with 0.2 it slides back whatever its wheels do."""
    physics = ContactPhysics(
        slope(15.0, "field", friction=0.2), [PlacedRobot("robot", robot_named("mecanum"), SE2())], TICK
    )
    moved = travelled(physics, BodyVelocity(0.5, 0.0, 0.0), 1.5)
    assert moved[0] < -0.3
    assert moved[2] < 0.0


def test_a_kerb_of_twelve_centimetres_stops_mecanum_on_a_slope() -> None:
    """The kerb follows the slope; wheels or body meet it, it is told by its name, and the robot neither climbs nor passes it."""
    base = slope(5.0, "field")
    rise = math.tan(math.radians(5.0))
    kerb = Solid("kerb", Shape.BOX, SE2(1.5, 0.0, 0.0), 0.15, 4.0, -0.5, 1.5 * rise + 0.12)
    simulation = Simulation(replace(base, solids=(kerb,)), robot_named("mecanum"), SimulationConfig(0, True))
    contacts = drive(simulation, BodyVelocity(0.5, 0.0, 0.0), 8.0)
    assert {c.other_geom for c in contacts} == {"kerb"}
    x, _, z = simulation.world_from_base.translation
    assert x + 0.3 < 1.5
    assert z < 1.5 * rise


@pytest.mark.parametrize("robot", ["mecanum", "mecanum+tilted", "go2", "g1"])
def test_points_of_a_leaning_robot_lie_on_the_true_surface(robot: str) -> None:
    """On 12 degrees, standing: every return lies on the slope or the wall within the sensor's noise."""
    rise = math.tan(math.radians(12.0))
    wall = Solid("wall", Shape.BOX, SE2(5.0, 0.0, 0.0), 0.2, 8.0, -5.0, 8.0)
    world = replace(slope(12.0, "field"), solids=(wall,))
    simulation = Simulation(world, robot_named(robot), SimulationConfig(0, False))
    clouds: list[PointCloud] = simulation.step(1_000_000_000).clouds
    mount = simulation.robot.model.sensor("livox").base_from_sensor
    points = (simulation.world_from_base @ mount).transform(np.concatenate([c.points for c in clouds]).astype(float))
    near = points[np.abs(points[:, :2]).max(axis=1) < 4.0]
    above = (near[:, 2] - near[:, 0] * rise) * math.cos(math.radians(12.0))
    wall_hits = points[(points[:, 2] > points[:, 0] * rise + 0.5) & (np.abs(points[:, 1]) < 3.0) & (points[:, 0] > 4.0)]
    off = np.concatenate([above, wall_hits[:, 0] - 4.9])
    assert len(off) > 2000
    assert np.quantile(np.abs(off), 0.95) < 0.04
    assert abs(float(np.median(off))) < 0.006


def test_a_pattern_that_does_not_repeat_fills_its_gaps() -> None:
    """Two clouds of a Mid-360 at rest share few directions, two of a spinning scanner all of them."""
    shared = []
    for robot, frame in (("mecanum", "livox"), ("spot", "velodyne")):
        model = robot_named(robot)
        perfect = replace(model, lidars={frame: model.lidars[frame].perfect()})
        clouds = Simulation(load_world("office"), perfect, SimulationConfig(0, True)).step(350_000_000).clouds
        seen = [np.round(c.points / np.linalg.norm(c.points, axis=1, keepdims=True), 4) for c in clouds[:2]]
        sets = [set(map(tuple, s.tolist())) for s in seen]
        shared.append(len(sets[0] & sets[1]) / len(sets[0]))
    assert shared[0] < 0.01
    assert shared[1] > 0.9


def test_the_walker_on_two_legs_stays_upright_where_others_lean() -> None:
    tilts = []
    for robot in ("go2", "g1"):
        simulation = Simulation(slope(10.0, "field"), robot_named(robot), SimulationConfig(0, True))
        simulation.step(500_000_000)
        up = simulation.world_from_base.rotate((0.0, 0.0, 1.0))
        tilts.append(math.degrees(math.acos(min(1.0, up[2]))))
    assert tilts[0] == pytest.approx(10.0, abs=0.3)
    assert tilts[1] < 0.3


def test_a_walking_body_sways_on_a_slope_about_its_lean() -> None:
    simulation = Simulation(slope(10.0, "field"), robot_named("go2"), SimulationConfig(0, True))
    pitches, rolls = [], []
    for _ in range(120):
        drive(simulation, BodyVelocity(0.6, 0.0, 0.0), 0.05)
        forward, left = (simulation.world_from_base.rotate(a) for a in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        pitches.append(math.degrees(math.asin(forward[2])))
        rolls.append(math.degrees(math.asin(left[2])))
    assert np.mean(pitches[40:]) == pytest.approx(10.0, abs=0.4)
    assert 1.0 < np.ptp(pitches[40:]) < 4.0
    assert 1.0 < np.ptp(rolls[40:]) < 4.0


def test_people_walk_on_the_slope_where_rays_and_robots_meet_them() -> None:
    """Somebody stands 2 m up a slope of 10 degrees: a ray at chest height over the ground there meets him, one at that height over z = 0
    passes under his feet, and a robot that drives up touches him."""
    rise = math.tan(math.radians(10.0))
    stander = Person("stander", ((2.0, 0.0), (2.001, 0.0)), speed=1e-6, yields=False)
    world = replace(slope(10.0, "field"), people=(stander,))
    crowd = Crowd(world, 0)
    rows, kinds, _ = crowd.as_rays_see_it(0.0)
    assert kinds.tolist() == [Shape.CYLINDER]
    assert rows[0, 2] - rows[0, 5] == pytest.approx(2.0 * rise, abs=1e-3)
    assert build_scene(world).solids.floor < 0.0
    simulation = Simulation(world, robot_named("mecanum"), SimulationConfig(0, True))
    contacts = drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 5.0)
    assert "stander" in {c.other_geom for c in contacts}
    touch = next(c for c in contacts if c.other_geom == "stander")
    assert 1.2 * rise < touch.position[2] < 2.0 * rise + 0.5


def test_runs_on_slopes_are_equal_bit_for_bit() -> None:
    def run() -> tuple[SE3, np.ndarray, list[tuple[float, ...]]]:
        simulation = Simulation(load_world("ramp"), robot_named("go2"), SimulationConfig(7))
        clouds, forces = [], []
        for _ in range(40):
            simulation.command(BodyVelocity(0.8, 0.0, 0.1))
            out = simulation.step(simulation.now_ns + 100_000_000)
            clouds += [c.points for c in out.clouds]
            forces += [i.linear_acceleration for i in out.imus]
        return simulation.world_from_base, np.concatenate(clouds), forces

    first, second = run(), run()
    assert first[0] == second[0]
    np.testing.assert_array_equal(first[1], second[1])
    assert first[2] == second[2]


@pytest.mark.parametrize(("robot", "crouch"), [("go2", 0.18), ("g1", 0.35), ("spot", 0.25)])
def test_who_sits_is_lower_obeys_nobody_and_stands_up_again(robot: str, crouch: float) -> None:
    simulation = Simulation(load_world("office"), robot_named(robot), SimulationConfig(0, True))
    legs = simulation.devices.legs
    assert legs is not None
    simulation.step(500_000_000)
    height = simulation.world_from_base.translation[2]
    legs.sit()
    simulation.step(simulation.now_ns + 2_000_000_000)
    assert simulation.world_from_base.translation[2] == pytest.approx(height - crouch, abs=1e-6)
    before = simulation.world_from_base.translation[:2]
    drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 1.0)
    assert np.hypot(*np.subtract(simulation.world_from_base.translation[:2], before)) < 1e-4
    legs.stand()
    drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 1.4)
    assert np.hypot(*np.subtract(simulation.world_from_base.translation[:2], before)) < 0.02
    drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 2.0)
    assert np.hypot(*np.subtract(simulation.world_from_base.translation[:2], before)) > 0.5
    assert simulation.world_from_base.translation[2] == pytest.approx(height, abs=0.03)


def test_wheels_have_nothing_to_stand_up_with() -> None:
    assert Simulation(load_world("office"), robot_named("mecanum"), SimulationConfig(0, True)).devices.legs is None
