"""People who do not yield: who they are, what they weigh, and whose fault a contact is."""

import math

import pytest

from ambler.core.messages import Contact
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import find_collisions, find_contacts
from ambler.sim.approach import ApproachMemory
from ambler.sim.movers import PERSON_GAP, Crowd, Walker, distance_to_polygon
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Person, WorldSpec
from ambler.sim.world_file import load_world

MODES = ["contact", "kinematic"]


def walking(robot: str, mode: str, command: BodyVelocity, way: tuple[tuple[float, float], ...], mass: float = 75.0):
    """Drive with a constant command for 6 s while somebody who does not yield walks his way; return contacts, simulation and the
    robot's places."""
    person = Person("person_0", way, 1.0, yields=False, mass=mass)
    seed = next(s for s in range(100) if 1.0 < Walker(person, s).position[0] < 2.5 or math.dist(*way) < 1.0)
    config = SimulationConfig(seed, is_perfect=True, physics="contact" if mode == "contact" else "kinematic")
    simulation = Simulation(WorldSpec("lane", (), SE2(), people=(person,)), robot_named(robot), config)
    walker = simulation.running.crowd.walkers[0]
    contacts: list[Contact] = []
    for _ in range(120):
        simulation.command(command)
        contacts += simulation.step(simulation.now_ns + 50_000_000).contacts
    return contacts, simulation, walker


@pytest.mark.parametrize("mode", MODES)
def test_who_walks_into_a_standing_robot_is_to_blame(mode: str) -> None:
    contacts, simulation, _ = walking("diff", mode, BodyVelocity(), ((3.0, 0.0), (-3.0, 0.0)))
    assert contacts
    assert {c.other_geom for c in contacts} == {"person_0"}
    assert all(c.approach is not None and c.approach < 0.05 for c in contacts)
    assert find_collisions(contacts) == ()
    assert len(find_contacts(contacts)) >= 1
    assert abs(simulation.world_from_base.translation[0]) < 0.4, "a person pushes no robot through the room"


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("vx", "wz"), [(0.5, 0.0), (0.0, 1.0)])
def test_a_robot_that_moves_towards_a_person_is_to_blame(mode: str, vx: float, wz: float) -> None:
    robot = "diff" if vx else "spot"
    way = ((2.0, 0.0), (2.0, 0.001)) if vx else ((0.0, 0.6), (0.0, 0.601))
    contacts, _, _ = walking(robot, mode, BodyVelocity(vx, 0.0, wz), way)
    assert len(find_collisions(contacts)) >= 1
    first = contacts[0]
    assert first.approach is not None
    reach = vx + wz * robot_named(robot).model.circumscribed_radius
    assert 0.1 < first.approach <= reach + 0.02


def test_the_last_half_second_counts_and_not_more() -> None:
    still, tick = [(1.0, 0.0)], 0.005
    for rest, is_blamed in ((0.3, True), (0.6, False)):
        memory = ApproachMemory(tick)
        x = 0.0
        for k in range(400):
            x += 0.5 * tick if k * tick < 2.0 - rest else 0.0
            memory.note([SE2(x, 0.0, 0.0)], still, [BodyVelocity()])
        assert (memory.approach(0, 0, (x + 0.2, 0.0)) > 0.05) == is_blamed


def test_approach_is_that_of_the_touched_point() -> None:
    """A robot that turns to the left moves its nose towards who stands at its left, and its tail away."""
    memory = ApproachMemory(0.005)
    for k in range(200):
        memory.note([SE2(0.0, 0.0, 0.4 * k * 0.005)], [(0.0, 3.0)], [BodyVelocity()])
    yaw = 0.4 * 199 * 0.005
    nose, tail = (0.5 * math.cos(yaw), 0.5 * math.sin(yaw)), (-0.5 * math.cos(yaw), -0.5 * math.sin(yaw))
    assert memory.approach(0, 0, nose) == pytest.approx(0.2, abs=0.02)
    assert memory.approach(0, 0, tail) < -0.1


@pytest.mark.parametrize(("driven", "expected"), [(0.0, 0.0), (0.3, 0.3), (-0.2, -0.2)])
def test_while_somebody_pushes_a_robot_only_what_it_drives_itself_counts(driven: float, expected: float) -> None:
    """Pushed towards him or turned by him, it is shoved; if it drives on towards him, it is to blame."""
    memory = ApproachMemory(0.005)
    for k in range(300):
        pushed = max(0, k - 100)
        pose = SE2(0.4 * pushed * 0.005, 0.0, 0.0)
        memory.note([pose], [(3.0, 0.0)], [BodyVelocity(driven, 0.0, 0.0)], [0] if pushed else [])
    assert memory.approach(0, 0, (0.9, 0.0)) == pytest.approx(expected, abs=1e-6)


def test_the_way_until_he_touched_it_is_its_own() -> None:
    memory = ApproachMemory(0.005)
    for k in range(300):
        pose = SE2(0.4 * min(k, 250) * 0.005, 0.0, 0.0)
        memory.note([pose], [(3.0, 0.0)], [BodyVelocity()], [0] if k > 250 else [])
    assert memory.approach(0, 0, (0.9, 0.0)) == pytest.approx(0.4, abs=0.01)


def test_what_a_robot_is_pushed_into_counts_by_what_it_drove_since_somebody_touched_it() -> None:
    memory = ApproachMemory(0.005)
    for k in range(300):
        speed = 0.2 if k < 280 else 0.03
        memory.note([SE2()], [(3.0, 0.0)], [BodyVelocity(speed, 0.0, 0.0)], [0] if k >= 285 else [])
    assert memory.is_pushed(0)
    assert memory.driven_speed(0, (0.3, 0.0)) == pytest.approx(0.03)
    memory.note([SE2()], [(3.0, 0.0)], [BodyVelocity(0.1, 0.0, 0.5)])
    assert memory.driven_speed(0, (0.3, 0.4)) == pytest.approx(math.hypot(0.1 - 0.5 * 0.4, 0.5 * 0.3))


def test_a_heavy_person_pushes_more_than_a_light_one_and_turns_round() -> None:
    shoved = []
    for mass in (20.0, 120.0):
        contacts, simulation, walker = walking("diff", "contact", BodyVelocity(), ((3.0, 0.0), (-3.0, 0.0)), mass)
        shoved.append(abs(simulation.world_from_base.translation[0]))
        assert contacts
        assert math.dist(walker.position, walker.wish) < 0.4
        held, away = walker.position[0], 0.0
        for _ in range(100):
            simulation.step(simulation.now_ns + 50_000_000)
            away = max(away, walker.position[0] - held)
        assert away > 1.0, "after some seconds he turns round"
    assert shoved[0] < shoved[1]


def test_who_walks_on_legs_puts_a_foot_aside_when_he_is_pushed_over() -> None:
    """Somebody who walks at 1.4 m/s into the side of a light base that makes way at 0.4 m/s had laid it on its side."""
    person = Person("person_0", ((0.0, 3.0), (0.0, -3.0)), 1.4, yields=False)
    seed = next(s for s in range(100) if 1.0 < Walker(person, s).position[1] < 2.5)
    config = SimulationConfig(seed, is_perfect=True)
    simulation = Simulation(WorldSpec("lane", (), SE2(), people=(person,)), robot_named("go2"), config)
    leans, forces = [], [0.0]
    for k in range(240):
        simulation.command(BodyVelocity(0.0, -0.4 if k < 100 else 0.0, 0.0))
        forces += [c.force for c in simulation.step(simulation.now_ns + 50_000_000).contacts]
        leans.append(math.degrees(math.acos(min(simulation.world_from_base.rotate((0.0, 0.0, 1.0))[2], 1.0))))
    assert max(forces) > 300.0
    assert 10.0 < max(leans) < 35.0
    assert max(leans[-20:]) < 3.0, "he is gone, and it stands"


def test_nobody_begins_where_a_robot_stands() -> None:
    """Of thirty seeds some would put one who walks along a lane upon the robot, which would be pressed into the floor. The others stay where they were."""
    person = Person("person_0", ((-4.0, 0.2), (4.0, 0.2)), yields=False)
    world, robot = WorldSpec("lane", (), SE2(), people=(person,)), robot_named("amr_omni")
    moved = 0
    for seed in range(30):
        simulation = Simulation(world, robot, SimulationConfig(seed, is_perfect=True))
        drawn, began = Walker(person, seed).position, simulation.running.crowd.walkers[0].position
        assert distance_to_polygon(began, robot.model.footprint) - person.radius >= PERSON_GAP
        is_clear = distance_to_polygon(drawn, robot.model.footprint) - person.radius >= PERSON_GAP
        assert began == drawn if is_clear else began != drawn
        moved += not is_clear
    assert 3 < moved < 25


def test_half_of_all_people_do_not_yield_unless_it_is_said() -> None:
    people = tuple(Person(f"person_{k}", ((0.0, 0.0), (5.0, 0.0))) for k in range(8))
    stubborn = [
        [w.person.name for w in Crowd(WorldSpec("w", (), SE2(), people=people), s).walkers if not w.yields]
        for s in range(6)
    ]
    assert {len(names) for names in stubborn} == {4}
    assert len({tuple(names) for names in stubborn}) > 1, "the seed decides who"
    assert not Walker(Person("p", people[0].way, yields=False), 0).yields


def test_a_world_says_who_yields_and_what_he_weighs(tmp_path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(
        "start: {x: 0, y: 0}\npeople: [{way: [[2, 7], [3, 7]], yields: false, mass: 90}, {way: [[2, 8], [3, 8]]}]\n"
    )
    first, second = load_world(path).people
    assert (first.yields, first.mass) == (False, 90.0)
    assert (second.yields, second.mass) == (None, 75.0)
