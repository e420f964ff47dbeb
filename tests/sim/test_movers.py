"""People and doors: where they may be, what stops them, and that scanners and contacts notice them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.faults import FaultInjector
from ambler.sim.movers import DT, PERSON_GAP, Crowd, SlidingDoor, Walker, distance_to_polygon
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Person, Shape, Solid, WorldSpec
from ambler.sim.world_file import load_world, world_names

FAR = np.array([[90.0, 0], [91, 0], [91, 1], [90, 1]])
LANE = Person("person_0", ((4.0, 0.0), (-4.0, 0.0)), speed=1.0)


def gap_to_solids(world: WorldSpec, points: NDArray[np.float64], height: float) -> float:
    """Least distance from any of the points (N, 2) to any solid that begins below a height."""
    gap = math.inf
    for s in world.solids:
        if s.z_min < height:
            local = np.abs(s.world_from_solid.inverse().transform(points))
            if s.shape is Shape.CYLINDER:
                away = np.hypot(*local.T) - 0.5 * s.size_x
            else:
                away = np.hypot(*np.maximum(local - [0.5 * s.size_x, 0.5 * s.size_y], 0.0).T)
            gap = min(gap, float(away.min()))
    return gap


@pytest.mark.parametrize("name", [n for n in world_names() if load_world(n).people])
def test_people_never_overlap_walls_or_the_start(name: str) -> None:
    world = load_world(name)
    for person in world.people:
        walker = Walker(person, 0)
        places = np.array([walker.place(float(at)) for at in np.arange(0.0, walker.length, 0.05)])
        assert gap_to_solids(world, places, person.height) > person.radius + 0.05, person.name
        assert np.hypot(*(places - [world.start.x, world.start.y]).T).min() > 0.75 + PERSON_GAP + person.radius


def test_people_walk_their_way_at_their_speed_and_the_seed_decides() -> None:
    walkers = [Walker(LANE, seed) for seed in (1, 1, 2)]
    assert walkers[0].at == walkers[1].at != walkers[2].at
    walker = walkers[0]
    way = 0.0
    for _ in range(200):
        before = walker.position
        walker.update([FAR])
        walker.take(walker.wish)
        way += math.dist(before, walker.position)
        assert abs(walker.position[1]) < 1e-12
        assert abs(walker.position[0]) <= 4.0
    assert way / (200 * DT) == pytest.approx(walker._speed, rel=0.02)
    assert 0.85 <= walker._speed <= 1.15


def test_a_person_halts_before_a_standing_robot_and_turns_round() -> None:
    robot = robot_named("diff").model.footprint + np.array([2.0, 0.0])
    walker = Walker(LANE, 3)
    gaps, visited = [], []
    for _ in range(3000):
        walker.update([robot])
        walker.take(walker.wish)
        gaps.append(distance_to_polygon(walker.position, robot) - 0.25)
        visited.append(walker.position[0])
    inside = [g for g in gaps if g < PERSON_GAP - 0.03]
    assert inside == [] or gaps[0] < PERSON_GAP, "it never comes nearer than half a metre"
    assert min(visited) < -3.9, "it turned round and went the other way"


def test_people_pass_each_other_and_are_no_wall() -> None:
    """Of three on one narrow way each walks as far as he would alone, one of them between two who come towards him."""
    people = (LANE, replace(LANE, name="person_1"), replace(LANE, name="person_2"))
    world = WorldSpec("lane", (), SE2(), people=people)
    crowd, nothing = Crowd(world, 5), FaultInjector((), world, ())
    alone = [Walker(person, 5) for person in people]
    least = math.inf
    for _ in range(1000):
        crowd.update([FAR], nothing, 0.0)
        crowd.take([w.wish for w in crowd.walkers])
        for walker in alone:
            walker.update([FAR])
            walker.take(walker.wish)
        places = [w.position for w in crowd.walkers]
        least = min(least, *(math.dist(places[i], places[j]) for i in range(3) for j in range(i)))
        assert places == [w.wish for w in alone]
    assert least < 0.3, "they did meet"


def test_a_scanner_sees_a_person_where_it_was_at_that_beam() -> None:
    world = WorldSpec("lane", (), SE2(), people=(replace(LANE, way=((3.0, -3.0), (3.0, 3.0))),))
    simulation = Simulation(world, robot_named("diff"), SimulationConfig(0, True, "kinematic"))
    seen = 0
    for _ in range(60):
        scan = simulation.step(simulation.now_ns + 100_000_000).scans[-1]
        hits = np.flatnonzero(np.isfinite(scan.ranges))
        angles = scan.angle_min + hits * scan.angle_increment
        walker = simulation.running.crowd.walkers[0]
        for k, angle in zip(hits, angles, strict=True):
            ago = scan.scan_time - k * scan.time_increment
            person = np.array(walker.position) - ago * np.array(walker.velocity)
            point = np.array([0.08, 0.0]) + scan.ranges[k] * np.array([math.cos(angle), math.sin(angle)])
            assert math.dist(point, person) == pytest.approx(0.25, abs=0.03)
            seen += 1
    assert seen > 200


@pytest.mark.parametrize("mode", ["contact", "kinematic"])
def test_driving_into_a_person_is_a_contact(mode: str) -> None:
    world = WorldSpec("lane", (), SE2(), people=(Person("person_0", ((1.2, 0.0), (1.2, 0.001)), 0.001),))
    config = SimulationConfig(0, physics="contact" if mode == "contact" else "kinematic")
    simulation = Simulation(world, robot_named("amr_omni"), config)
    contacts = []
    for _ in range(40):
        simulation.command(BodyVelocity(0.6, 0.0, 0.0))
        contacts += simulation.step(simulation.now_ns + 50_000_000).contacts
    assert contacts
    assert {c.other_geom for c in contacts} == {"person_0"}
    assert contacts[0].speed > 0.3
    person = simulation.running.crowd.walkers[0].position
    assert simulation.world_from_base.translation[0] + 0.6 < person[0] - 0.2, "nobody is run through"
    assert (person[0] > 1.25) == (mode == "contact"), "people of finite mass are pushed away"


def test_doors_of_a_world_slide_into_their_walls(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(
        "start: {x: 1, y: 2, yaw_deg: 90}\nwalls: [{from: [0, 0], to: [6, 0], doors: [{at: 2.0, width: 1.2}]}]"
    )
    world = load_world(path)
    (door,) = world.doors
    assert math.hypot(*door.slide) == pytest.approx(1.2)
    opened = replace(
        door.leaf,
        world_from_solid=SE2(
            door.leaf.world_from_solid.x + door.slide[0],
            door.leaf.world_from_solid.y + door.slide[1],
            door.leaf.world_from_solid.yaw,
        ),
    )
    walls = [s for s in world.solids if s.z_min == 0.0]
    for corner in opened.corners():
        local = [w.world_from_solid.inverse().transform(corner[None])[0] for w in walls]
        assert any(
            abs(p[0]) <= 0.5 * w.size_x + 1e-9 and abs(p[1]) <= 0.5 * w.size_y
            for p, w in zip(local, walls, strict=True)
        )


def test_a_door_waits_for_who_stands_in_it_and_then_closes() -> None:
    door = SlidingDoor(load_world("building").doors[0])
    door.is_closing = True
    center = door.door.leaf.world_from_solid
    robot = center.transform(robot_named("amr_omni").model.footprint)
    for _ in range(200):
        door.update([robot], [])
    assert door.openness == 1.0
    for _ in range(200):
        door.update([FAR], [])
    assert door.openness == 0.0
    assert door.position == (center.x, center.y)
    door.is_closing = False
    door.update([robot], [])
    assert door.openness > 0.0


def test_light_passes_glass_unless_it_meets_it_squarely() -> None:
    pane = Solid("pane", Shape.BOX, SE2(2.0, 0.0, 0.0), 0.02, 6.0, 0.0, 2.0, is_glass=True)
    wall = Solid("wall", Shape.BOX, SE2(4.25, 0.0, 0.0), 0.5, 40.0, 0.0, 2.0)
    simulation = Simulation(WorldSpec("glass", (pane, wall), SE2()), robot_named("diff"), SimulationConfig(0, True))
    scan = simulation.step(100_000_000).scans[0]
    angles = scan.angle_min + np.arange(720) * scan.angle_increment
    forward = scan.ranges * np.cos(angles) + 0.08
    square, slanted = np.abs(angles) < math.radians(11), (np.abs(angles) > math.radians(13)) & (np.abs(angles) < 1.2)
    np.testing.assert_allclose(forward[square], 1.99, atol=0.01)
    np.testing.assert_allclose(forward[slanted], 4.0, atol=0.02)
    for _ in range(100):
        simulation.command(BodyVelocity(0.6, 0.0, 0.0))
        out = simulation.step(simulation.now_ns + 50_000_000)
        if out.contacts:
            break
    assert out.contacts[0].other_geom == "pane"
