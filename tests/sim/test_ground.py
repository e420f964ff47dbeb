"""Robots on ground that is not flat: they stand, lean, climb and slide as the slope and the friction say."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import Contact, LaserScan
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.base import PlacedRobot
from ambler.sim.body import TICK
from ambler.sim.contact_physics import ContactPhysics
from ambler.sim.kinematic_physics import KinematicPhysics
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.world import BodySpec, World
from ambler.sim.world_file import load_world

# The middle of `porter` is so high that on slopes of 10 degrees its caster carries it, and its wheels spin: it is for level floors.
SLOPING = [name for name in robot_names() if name != "porter"]


def slope(angle_deg: float, kind: str, heading_deg: float = 0.0, friction: float = 0.8) -> WorldSpec:
    """A plane that rises along a direction `heading_deg` to the right of the robot's, through the start at height 0."""
    rise = math.tan(math.radians(angle_deg))
    turn = SE2(0.0, 0.0, math.radians(-heading_deg))
    if kind == "mesh":
        corners = np.array([[x, y, x * rise] for x, y in ((-6.0, -6.0), (6.0, -6.0), (6.0, 6.0), (-6.0, 6.0))])
        plate = TriangleMesh("plate", corners, np.array([[0, 1, 2], [0, 2, 3]])).moved(turn)
        return WorldSpec("slope", (), SE2(), friction=friction, meshes=(plate,), terrain=pit(-1.0))
    x = np.arange(-6.0, 6.05, 0.1)
    field = HeightField("hill", np.tile(rise * x, (len(x), 1)), 0.1, SE2(-6.0, -6.0, 0.0)).moved(turn)
    return WorldSpec("slope", (), SE2(), friction=friction, terrain=field)


def pit(depth: float) -> HeightField:
    """Flat ground far below a mesh, but for a knoll under the start, so that the robot starts on the mesh."""
    heights = np.full((3, 3), depth)
    heights[1, 1] = -0.2
    return HeightField("pit", heights, 10.0, SE2(-10.0, -10.0, 0.0))


def alone(world: WorldSpec, robot: str) -> ContactPhysics:
    """One robot at the start of a world."""
    return ContactPhysics(world, [PlacedRobot("robot", robot_named(robot), world.start)], TICK)


def lean_deg(physics: ContactPhysics) -> tuple[float, float]:
    """Roll and pitch in degrees; pitch is negative uphill."""
    w, x, y, z = physics.carriage(0).rotation
    return (
        math.degrees(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))),
        math.degrees(math.asin(2 * (w * y - z * x))),
    )


def steps(physics: ContactPhysics, command: BodyVelocity, seconds: float) -> None:
    for _ in range(round(seconds / TICK)):
        physics.step([command])


def travelled(physics: ContactPhysics, command: BodyVelocity, seconds: float) -> np.ndarray:
    before = np.array(physics.carriage(0).position)
    steps(physics, command, seconds)
    return np.array(physics.carriage(0).position) - before


@pytest.mark.parametrize("robot", SLOPING)
@pytest.mark.parametrize("kind", ["field", "mesh"])
def test_on_five_degrees_a_robot_leans_five_degrees_and_stays(robot: str, kind: str) -> None:
    physics = alone(slope(5.0, kind), robot)
    assert lean_deg(physics) == pytest.approx((0.0, -5.0), abs=0.3)
    moved = travelled(physics, BodyVelocity(), 3.0)
    assert np.linalg.norm(moved) < 5e-4
    assert lean_deg(physics) == pytest.approx((0.0, -5.0), abs=0.3)


@pytest.mark.parametrize("robot", SLOPING)
def test_across_a_slope_a_robot_rolls_and_keeps_its_heading(robot: str) -> None:
    physics = alone(slope(5.0, "field", 90.0), robot)
    assert lean_deg(physics) == pytest.approx((-5.0, 0.0), abs=0.3)
    travelled(physics, BodyVelocity(), 2.0)
    assert abs(physics.carriage(0).to_se2().yaw) < math.radians(0.2)
    moved = travelled(physics, BodyVelocity(0.3, 0.0, 0.0), 3.0)
    assert moved[0] == pytest.approx(0.9, abs=0.02)
    assert abs(moved[1]) < 0.01
    assert abs(moved[2]) < 0.001


@pytest.mark.parametrize("robot", SLOPING)
@pytest.mark.parametrize(("kind", "angle_deg"), [("field", 10.0), ("field", -5.0), ("mesh", 10.0)])
def test_travel_is_along_the_slope_at_the_wanted_speed(robot: str, kind: str, angle_deg: float) -> None:
    physics = alone(slope(angle_deg, kind), robot)
    steps(physics, BodyVelocity(0.4, 0.0, 0.0), 1.0)
    moved = travelled(physics, BodyVelocity(0.4, 0.0, 0.0), 3.0)
    assert np.linalg.norm(moved) == pytest.approx(1.2, abs=0.005)
    assert math.degrees(math.atan2(moved[2], moved[0])) == pytest.approx(angle_deg, abs=0.1)
    assert physics.touches(0) == ()


@pytest.mark.parametrize("robot", SLOPING)
def test_robots_slide_when_friction_is_less_than_the_slope(robot: str) -> None:
    """tan 10 degrees is 0.18: 0.35 holds; with 0.1 it slides with g (sin - 0.1 cos), and `diff` faster: its caster has no friction."""
    stays = alone(slope(10.0, "field", friction=0.35), robot)
    assert np.linalg.norm(travelled(stays, BodyVelocity(), 1.5)) < 0.002
    slides = alone(slope(10.0, "field", friction=0.1), robot)
    angle = math.radians(10.0)
    expected = -0.5 * 9.81 * (math.sin(angle) - 0.1 * math.cos(angle))
    moved = travelled(slides, BodyVelocity(), 1.0)
    if robot == "diff":
        assert -0.5 * 9.81 * math.sin(angle) < moved[0] < expected * math.cos(angle)
    else:
        assert np.linalg.norm(moved) == pytest.approx(-expected, rel=0.08)
    assert moved[2] == pytest.approx(moved[0] * math.tan(angle), abs=2e-3)


def drive(simulation: Simulation, command: BodyVelocity, seconds: float) -> list[Contact]:
    contacts = []
    for _ in range(round(seconds * 20)):
        simulation.command(command)
        contacts += simulation.step(simulation.now_ns + 50_000_000).contacts
    return contacts


@pytest.mark.parametrize("robot", SLOPING)
def test_the_ramp_leads_up_to_the_platform_and_down_again(robot: str) -> None:
    simulation = Simulation(load_world("ramp"), robot_named(robot), SimulationConfig(1, True))
    contacts, heights = [], []
    for _ in range(32):
        contacts += drive(simulation, BodyVelocity(0.6, 0.0, 0.0), 1.0)
        heights.append(simulation.start_from_base.translation[2])
    assert contacts == []
    assert max(heights) == pytest.approx(0.5995, abs=0.02)
    x, y, z = simulation.start_from_base.translation
    assert 17.0 < x < 20.0
    assert abs(y) < 0.3
    assert abs(z) < 0.02


def test_a_kerb_of_twelve_centimetres_stops_the_diff() -> None:
    """The body meets it first; the contact is told with the kerb's name, and the robot neither climbs nor passes."""
    world = load_world("ramp", start=SE2(2.0, 6.5, 0.0))
    simulation = Simulation(world, robot_named("diff"), SimulationConfig(1, True))
    contacts = drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 8.0)
    x, _, z = simulation.start_from_base.translation
    assert x + 0.25 == pytest.approx(1.5, abs=0.03)
    assert abs(z) < 0.02
    assert {(c.robot_geom, c.other_geom) for c in contacts} == {("body", "kerb")}
    assert contacts[0].speed == pytest.approx(0.4, abs=0.06)


def test_a_mesh_is_met_where_its_triangles_are_and_not_its_hull() -> None:
    """A portal of two posts and a lintel: its convex hull is a wall, its triangles let the robot through."""
    ring = np.array([[-1.0, 0], [-0.8, 0], [-0.8, 1.0], [0.8, 1.0], [0.8, 0], [1.0, 0], [1.0, 1.2], [-1.0, 1.2]])
    vertices = np.array([[x, y, z] for x in (2.0, 2.3) for y, z in ring])
    sides = [t for k in range(8) for a, b in [(k, (k + 1) % 8)] for t in ((a, b, b + 8), (a, b + 8, a + 8))]
    front = [(0, 1, 2), (0, 2, 7), (2, 6, 7), (2, 3, 6), (3, 5, 6), (3, 4, 5)]
    portal = TriangleMesh("portal", vertices, np.array([*sides, *front, *[[c + 8, b + 8, a + 8] for a, b, c in front]]))
    simulation = Simulation(WorldSpec("w", (), SE2(), meshes=(portal,)), robot_named("diff"), SimulationConfig(1, True))
    assert drive(simulation, BodyVelocity(0.8, 0.0, 0.0), 5.0) == []
    assert simulation.start_from_base.translation[0] > 3.0
    beside = WorldSpec("w", (), SE2(), meshes=(portal.moved(SE2(0.0, 0.9, 0.0)),))
    simulation = Simulation(beside, robot_named("diff"), SimulationConfig(1, True))
    assert {c.other_geom for c in drive(simulation, BodyVelocity(0.4, 0.0, 0.0), 6.0)} == {"portal"}
    assert simulation.start_from_base.translation[0] + 0.25 < 2.03


def test_many_triangles_carry_like_one_plane() -> None:
    """1800 triangles of uneven shape: the wheels' way differs from that on the floor by less than a millimetre."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 31), np.linspace(-3.0, 3.0, 31))
    shift = rng.uniform(-0.06, 0.06, (2, 31, 31))
    vertices = np.stack([x + shift[0], y + shift[1], np.zeros_like(x)], axis=-1).reshape(-1, 3)
    a = (np.arange(30)[:, None] * 31 + np.arange(30)).ravel()
    triangles = np.stack([a, a + 1, a + 32, a, a + 32, a + 31], axis=1).reshape(-1, 3)
    quilt = WorldSpec(
        "quilt", (), SE2(), meshes=(TriangleMesh("quilt", vertices + np.array([0.0, 0.0, 0.1]), triangles),)
    )
    ends = []
    for world in (quilt, WorldSpec("plain", (), SE2())):
        physics = alone(world, "amr_omni")
        start = physics.carriage(0).position[2]
        steps(physics, BodyVelocity(0.4, 0.1, 0.0), 3.0)
        ends.append(np.array(physics.carriage(0).position) - [0.0, 0.0, start])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)


def test_the_level_of_the_start_is_that_of_what_lies_under_the_robot() -> None:
    """Floor, terrain, a mesh as a plinth; a roof, or a solid, is not stood on."""
    plate = np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    plinth, roof = (
        TriangleMesh("plinth", plate + np.array([0, 0, 0.3]), faces),
        TriangleMesh("roof", plate + np.array([0, 0, 2.0]), faces),
    )
    table = Solid("table", Shape.BOX, SE2(), 1.0, 1.0, 0.0, 0.4)
    world, place = WorldSpec("w", (table,), SE2(), meshes=(roof,)), np.zeros((1, 2))
    assert world.ground_at(place)[0] == 0.0
    assert replace(world, meshes=(roof, plinth)).ground_at(place)[0] == pytest.approx(0.3)
    high = HeightField("high", np.full((2, 2), 1.7), 4.0, SE2(-2.0, -2.0, 0.0))
    assert replace(world, terrain=high).ground_at(place)[0] == pytest.approx(2.0)
    assert replace(world, meshes=(), terrain=high).ground_at(np.array([[5.0, 0.0]]))[0] == pytest.approx(1.695)
    physics = alone(WorldSpec("w", (), SE2(), meshes=(roof, plinth)), "diff")
    assert physics.carriage(0).position[2] == pytest.approx(0.3, abs=1e-3)


def test_robots_of_one_world_carry_their_own_loads_and_touch_no_ground() -> None:
    """One stands across the slope, one drives up, one walks down: each has its own start, lean and speed."""
    names, starts = ("diff", "diff", "spot"), (SE2(0.0, -3.0, math.pi / 2), SE2(-2.0, 0.0, 0.0), SE2(2.0, 3.0, math.pi))
    placed = [PlacedRobot(f"r{k}", robot_named(n), s) for k, (n, s) in enumerate(zip(names, starts, strict=True))]
    physics = ContactPhysics(slope(10.0, "field"), placed, TICK)
    for k, start in enumerate(starts):
        assert physics.carriage(k).to_se2().distance_to(start) < 2e-3
        assert physics.carriage(k).position[2] == pytest.approx(start.x * math.tan(math.radians(10.0)), abs=0.02)
    commands = [BodyVelocity(), BodyVelocity(0.4, 0.0, 0.0), BodyVelocity(0.4, 0.0, 0.0)]
    for _ in range(200):
        physics.step(commands)
    before = np.array([physics.carriage(k).position for k in range(3)])
    for _ in range(400):
        physics.step(commands)
    moved = np.array([physics.carriage(k).position for k in range(3)]) - before
    assert np.linalg.norm(moved[0]) < 2e-3
    up = np.array([math.cos(math.radians(10.0)), 0.0, math.sin(math.radians(10.0))])
    np.testing.assert_allclose(moved[1], 0.8 * up, atol=0.01)
    np.testing.assert_allclose(moved[2], -0.8 * up, atol=0.01)
    assert [physics.touches(k) for k in range(3)] == [(), (), ()]


def test_robots_on_high_ground_see_each_other_there() -> None:
    """Level ground 1.7 m up: the second robot is seen by the same beams at the same distances as on the floor."""
    high = HeightField("high", np.full((2, 2), 1.7), 20.0, SE2(-10.0, -10.0, 0.0))
    scans = []
    for world in (WorldSpec("floor", (), SE2()), WorldSpec("high", (), SE2(), terrain=high)):
        bodies = [BodySpec("a", robot_named("diff")), BodySpec("b", robot_named("diff"), SE2(2.0, 0.0, 0.5))]
        running = World(world, bodies, SimulationConfig(1, True))
        (lidar, *_) = robot_devices(running, "a").lidars
        lidar.open()
        running.advance(0)
        scan = next(iter(lidar.read(200_000_000)))
        assert isinstance(scan, LaserScan)
        scans.append(scan.ranges)
    assert np.isfinite(scans[0]).sum() > 8
    np.testing.assert_allclose(scans[1], scans[0], atol=2e-3)


@pytest.mark.parametrize("robot", SLOPING)
def test_the_cheap_mode_lies_on_the_slope_and_travels_along_it(robot: str) -> None:
    """Ten degrees ahead: it leans by them, goes the wanted way along the slope, and climbs its sine."""
    physics = KinematicPhysics(slope(10.0, "field"), [PlacedRobot("robot", robot_named(robot), SE2())], TICK)
    w, x, y, z = physics.carriage(0).rotation
    assert math.degrees(math.asin(2 * (w * y - z * x))) == pytest.approx(-10.0, abs=0.01)
    before = np.array(physics.carriage(0).position)
    for _ in range(400):
        physics.step([BodyVelocity(0.4, 0.0, 0.0)])
    moved = np.array(physics.carriage(0).position) - before
    assert np.linalg.norm(moved) == pytest.approx(0.8, abs=0.002)
    assert moved[2] == pytest.approx(0.8 * math.sin(math.radians(10.0)), abs=0.002)
    assert physics.touches(0) == ()


def test_the_cheap_mode_takes_the_ramp_and_halts_at_a_kerb() -> None:
    ramp = load_world("ramp")
    physics = KinematicPhysics(ramp, [PlacedRobot("robot", robot_named("mecanum"), ramp.start)], TICK)
    heights = []
    for _ in range(3000):
        physics.step([BodyVelocity(0.8, 0.0, 0.0)])
        heights.append(physics.carriage(0).position[2])
    assert max(heights) == pytest.approx(0.5995, abs=0.01)
    kerb = ramp.meshes[0].vertices
    below = SE2(float(kerb[:, 0].min()) - 0.8, float(kerb[:, 1].mean()), 0.0)
    physics = KinematicPhysics(ramp, [PlacedRobot("robot", robot_named("mecanum"), below)], TICK)
    for _ in range(600):
        physics.step([BodyVelocity(0.8, 0.0, 0.0)])
    assert physics.touches(0)
    assert physics.carriage(0).position[0] + 0.3 < kerb[:, 0].min() + 0.01
    assert physics.carriage(0).position[2] < 0.01


def test_the_cheap_mode_keeps_to_its_level_of_a_garage() -> None:
    """The route leads over the ramp to the upper level, above where it began."""
    garage = load_world("garage")
    upper = SE2(0.5 * sum(garage.bounds()[::2]), garage.start.y, 0.0)
    floors = [float(garage.ground_at(np.array([[upper.x, upper.y]]), height)[0]) for height in (0.0, 3.0)]
    assert floors == pytest.approx([0.0, 3.0])
