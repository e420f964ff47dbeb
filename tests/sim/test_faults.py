"""Faults: how they are written, and that each one does to the measurements exactly what it says."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.safety.stuck_scan import StuckScan
from ambler.sim.faults import START_ROOM, Fault, FaultKind, numbers_of_people, world_with_faults
from ambler.sim.movers import Walker
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import truth_grid
from ambler.sim.world_file import load_world
from tests.sim.test_movers import gap_to_solids


def simulation_with(fault: str, robot: str = "diff", world: str | WorldSpec = "lab_empty") -> Simulation:
    spec = load_world(world) if isinstance(world, str) else world
    return Simulation(spec, robot_named(robot), SimulationConfig(1, physics="kinematic", faults=(Fault.parse(fault),)))


def scans_of(simulation: Simulation, seconds: float, frame: str) -> list[tuple[int, LaserScan]]:
    """(time of arrival, scan) of everything that one scanner sends while the robot turns slowly."""
    out = []
    for _ in range(round(seconds * 20)):
        simulation.command(BodyVelocity(0.0, 0.0, 0.3))
        step = simulation.step(simulation.now_ns + 50_000_000)
        out += [(simulation.now_ns, s) for s in step.scans if s.frame == frame]
    return out


def test_faults_are_written_in_one_line() -> None:
    assert Fault.parse("wheel_slip") == Fault(FaultKind.WHEEL_SLIP, 0.0, math.inf)
    assert Fault.parse("door@door_4_0:3:7.5") == Fault(FaultKind.DOOR, 3.0, 7.5, "door_4_0")
    assert Fault.parse("people:5").is_on(6.0)
    assert not Fault.parse("people:5:6").is_on(6.0)


@pytest.mark.parametrize(
    "text", ["gremlins", "people:x", "people:5:4", "people:1:2:3", "people@me", "glass:3", "people:-1", "people:nan"]
)
def test_a_badly_written_fault_gets_one_clear_line(text: str) -> None:
    with pytest.raises(BadInputError, match=text.split(":", maxsplit=1)[0]):
        Fault.parse(text)


def test_the_command_refuses_bad_faults_and_reads_those_of_a_profile(tmp_path: Path) -> None:
    profile = tmp_path / "p.yaml"
    profile.write_text("faults: [gremlins:1:2]")
    assert main(["demo", "--no-view", "--world", "lab_empty", "--fault", "gremlins", "--out", str(tmp_path)]) == 2
    assert main(["demo", "--no-view", "--world", "lab_empty", "--profile", str(profile), "--out", str(tmp_path)]) == 2
    profile.write_text("faults: gremlins")
    assert main(["demo", "--no-view", "--world", "lab_empty", "--profile", str(profile), "--out", str(tmp_path)]) == 2


@pytest.mark.parametrize("fault", ["scanner_stuck@radar", "door", "door@door_9_9"])
def test_a_target_that_is_not_there_is_named(fault: str) -> None:
    with pytest.raises(BadInputError, match=r"radar|no door"):
        simulation_with(fault, world="building" if "@door" in fault else "lab_empty")


@pytest.mark.parametrize("robot", ["diff", "amr_omni", "spot"])
def test_slipping_wheels_count_what_the_base_does_not_go(robot: str, open_floor: WorldSpec) -> None:
    simulation = simulation_with("wheel_slip:1:3", robot, open_floor)
    simulation = Simulation(
        open_floor, simulation.robot, SimulationConfig(0, True, "kinematic", (Fault.parse("wheel_slip:1:3"),))
    )
    for _ in range(80):
        simulation.command(BodyVelocity(0.4, 0.0, 0.0))
        out = simulation.step(simulation.now_ns + 50_000_000)
    counted = out.odometry[-1].pose.translation[0] - simulation.world_from_base.translation[0]
    assert counted == pytest.approx(0.3 * 0.4 * 2.0, abs=0.02)
    assert out.odometry[-1].linear[0] == pytest.approx(0.4, abs=1e-3)


def test_a_scanner_drops_out_and_comes_back() -> None:
    simulation = simulation_with("scanner_dropout@front_left:0.5:1.0", "amr_omni")
    ends = [now * 1e-9 for now, _ in scans_of(simulation, 1.5, "front_left")]
    assert [e for e in ends if 0.55 < e <= 1.0] == []
    assert len(ends) == pytest.approx(1.0 / 0.08, abs=2)
    other = simulation_with("scanner_dropout@front_left", "amr_omni")
    assert len(scans_of(other, 0.5, "rear_left")) >= 5


def test_a_stuck_scanner_repeats_itself_with_new_stamps() -> None:
    scans = [s for _, s in scans_of(simulation_with("scanner_stuck:0.5:1.0"), 1.5, "laser")]
    stamps = [s.stamp_ns for s in scans]
    assert np.diff(stamps).tolist() == [100_000_000] * (len(scans) - 1)
    same = [np.array_equal(a.ranges, b.ranges, equal_nan=True) for a, b in itertools.pairwise(scans)]
    assert sum(same) == 5
    assert not same[0]
    assert not same[-1]


def test_late_messages_are_stamped_as_if_they_were_new() -> None:
    clean = scans_of(simulation_with("wheel_slip:90:91"), 1.0, "laser")
    late = scans_of(simulation_with("delayed_stamps"), 1.2, "laser")
    assert late[0][0] - clean[0][0] == 200_000_000
    for (_, a), (_, b) in zip(clean, late, strict=False):
        np.testing.assert_array_equal(a.ranges, b.ranges)
        assert b.stamp_ns - a.stamp_ns == 200_000_000


@pytest.mark.parametrize("name", ["lab_empty", "office", "building"])
def test_people_of_the_fault_walk_where_there_is_room(name: str) -> None:
    world = load_world(name)
    people = world_with_faults(world, (Fault.parse("people"),), 4).people
    assert len(people) == 3
    for person in people:
        walker = Walker(person, 4)
        places = np.array([walker.place(float(at)) for at in np.arange(0.0, walker.length, 0.1)])
        assert gap_to_solids(world, places, person.height) > person.radius
        assert np.hypot(*(places - [world.start.x, world.start.y]).T).min() > START_ROOM


def test_people_of_the_fault_stand_until_it_begins() -> None:
    simulation = simulation_with("people:0.5:1.0")
    places = []
    for _ in range(15):
        simulation.step(simulation.now_ns + 100_000_000)
        places.append([w.position for w in simulation.running.crowd.walkers])
    moved = [np.abs(np.subtract(a, b)).max() > 0 for a, b in itertools.pairwise(places)]
    assert moved[:9] == [False] * 4 + [True] * 5
    assert not any(moved[13:]), "within a few steps everybody stands"


@pytest.mark.parametrize(
    ("target", "numbers"), [("", (3, 2)), ("10", (10, 5)), ("7", (7, 4)), ("10/5", (10, 5)), ("4/0", (4, 0))]
)
def test_the_fault_says_how_many_people_and_how_many_do_not_yield(target: str, numbers: tuple[int, int]) -> None:
    assert numbers_of_people(target) == numbers
    fault = Fault.parse(f"people@{target}" if target else "people")
    people = world_with_faults(load_world("office"), (fault,), 4).people
    assert (len(people), sum(p.yields is False for p in people)) == numbers


@pytest.mark.parametrize("target", ["0", "3/4", "x", "3/", "/3", "-1"])
def test_wrong_numbers_of_people_are_one_clear_error(target: str) -> None:
    with pytest.raises(BadInputError, match="people"):
        Fault.parse(f"people@{target}")


@pytest.mark.parametrize("mode", ["contact", "kinematic"])
def test_a_closed_door_is_seen_and_stops_the_robot(mode: str, tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(
        "start: {x: 2, y: 2, yaw_deg: -90}\nwalls: [{from: [0, 0], to: [6, 0], doors: [{at: 2.0, width: 1.2}]}]\n"
        "boxes: [{center: [2, -3], size: [1, 1, 1]}]"
    )
    config = SimulationConfig(
        0, True, "contact" if mode == "contact" else "kinematic", faults=(Fault.parse("door:1:20"),)
    )
    simulation = Simulation(load_world(path), robot_named("diff"), config)
    before = simulation.step(900_000_000).scans[-1].ranges[360]
    after = simulation.step(4_000_000_000).scans[-1].ranges[360]
    assert before == pytest.approx(4.5 - 0.08, abs=0.01)
    assert after == pytest.approx(2.0 - 0.03 - 0.08, abs=0.01)
    contacts = []
    for _ in range(100):
        simulation.command(BodyVelocity(0.5, 0.0, 0.0))
        contacts += simulation.step(simulation.now_ns + 50_000_000).contacts
    assert {c.other_geom for c in contacts} == {"door_0_0"}
    assert simulation.step(26_000_000_000).scans[-1].ranges[360] > 2.0, "it opens again"


def test_glass_changes_what_light_sees_and_nothing_else() -> None:
    world = load_world("office")
    glass = world_with_faults(world, (Fault.parse("glass"),), 2)
    panes = [s for s in glass.solids if s.is_glass]
    assert len(panes) == 2
    spec, before = truth_grid(world, 0.28, 0.05)
    _, after = truth_grid(glass, 0.28, 0.05)
    # The panes are thinner than their walls: only cells of surfaces beside them differ.
    changed = np.argwhere(before != after)
    centers = np.array([spec.center_of(int(iy), int(ix)) for iy, ix in changed])
    for center in centers:
        local = [p.world_from_solid.inverse().transform(center[None])[0] for p in panes]
        assert any(abs(q[0]) < 0.9 and abs(q[1]) < 0.15 for q in local)


def test_a_scan_that_repeats_while_the_robot_moves_is_stuck() -> None:
    detector, rng = StuckScan(), np.random.default_rng(0)
    scan = rng.random(100)
    assert not detector.update(scan, SE2())
    assert not detector.update(scan.copy(), SE2(0.01, 0.0, 0.0)), "standing proves nothing"
    assert detector.update(scan.copy(), SE2(0.03, 0.0, 0.0))
    assert detector.update(scan.copy(), SE2(0.03, 0.0, 0.0)), "until it measures again"
    assert not detector.update(rng.random(100), SE2(0.03, 0.0, 0.0))
    assert not detector.update(np.full(100, np.inf), SE2())
    assert not detector.update(np.full(100, np.inf), SE2(1.0, 0.0, 0.0)), "an empty hall looks like itself"
    assert not detector.update(scan, SE2(0.0, 0.0, 3.13))
    assert detector.update(scan, SE2(0.0, 0.0, -3.1)), "turning counts as motion"
