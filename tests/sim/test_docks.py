"""The simulated dock: contacts, battery, and what the camera shows of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.core.camera import MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.messages import PowerSupply
from ambler.core.se2 import SE2
from ambler.perception.fiducials import FiducialDetector
from ambler.perception.planar import PlanarConfig, scan_to_points
from ambler.registration.reflectors import DetectorConfig
from ambler.sim.battery import Battery, BatterySpec
from ambler.sim.dock_body import CONTACTS, FILM, LIP_GAP, marker_poses
from ambler.sim.faults import Fault, FaultKind
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Person, Shape, SimDock, Solid, WorldSpec
from ambler.sim.world_file import load_world

ROOM = load_world("dock_room")
DOCK = ROOM.docks[0]
SPEC = BatterySpec()


def stand(battery: Battery, dock_from_base: SE2, seconds: float, *, has_power: bool = True) -> PowerSupply:
    """Stand at a pose of the dock's frame; returns what the battery says at the end."""
    told = None
    for k in range(round(seconds / 0.005)):
        battery.update(DOCK.world_from_dock @ dock_from_base, 0.0, 0.005, has_power=has_power)
        told = battery.told(k) or told
    assert told is not None
    return told.supply


@pytest.mark.parametrize(
    ("pose", "meets"),
    [
        (SE2(), True),
        (SE2(-0.0009, 0.0, 0.0), True),
        (SE2(-0.0011, 0.0, 0.0), False),
        (SE2(0.0, 0.0099, 0.0), True),
        (SE2(0.0, -0.0101, 0.0), False),
        (SE2(0.0, 0.0, math.radians(0.99)), True),
        (SE2(0.0, 0.0, math.radians(-1.01)), False),
        (SE2(-1.0, 0.0, 0.0), False),
    ],
)
def test_contacts_close_within_tolerance_only(pose: SE2, meets: bool) -> None:
    supply = stand(Battery(SPEC, ROOM.docks), pose, 0.5)
    assert supply is (PowerSupply.CHARGING if meets else PowerSupply.DISCHARGING)


def test_the_charge_is_the_integral_of_the_current() -> None:
    away, battery = SE2(-1.0, 0.0, 0.0), Battery(SPEC, ROOM.docks, share=0.5)
    stand(battery, away, 36.0)
    assert math.isclose(battery.share, 0.5 - SPEC.idle_current * 36.0 / (3600.0 * SPEC.capacity_ah), rel_tol=1e-9)
    before = battery.share
    stand(battery, SE2(), 36.0 + SPEC.delay)
    gained = SPEC.charge_current * 36.0 - SPEC.idle_current * SPEC.delay
    assert math.isclose(battery.share - before, gained / (3600.0 * SPEC.capacity_ah), rel_tol=1e-3)
    assert stand(Battery(SPEC, ROOM.docks, share=0.99999), SE2(), 1.0) is PowerSupply.FULL


def test_without_power_there_is_contact_but_no_current() -> None:
    assert stand(Battery(SPEC, ROOM.docks), SE2(), 1.0, has_power=False) is PowerSupply.NOT_CHARGING


def test_a_stopped_charge_begins_again_when_the_contacts_close_anew() -> None:
    battery = Battery(SPEC, ROOM.docks)
    assert stand(battery, SE2(), 0.5) is PowerSupply.CHARGING
    battery.stop_charging()
    assert stand(battery, SE2(), 0.5) is PowerSupply.NOT_CHARGING
    assert stand(battery, SE2(-0.1, 0.0, 0.0), 0.5) is PowerSupply.DISCHARGING
    assert stand(battery, SE2(), 0.5) is PowerSupply.CHARGING


def test_the_lip_stops_the_robot_a_little_beyond_the_docked_pose() -> None:
    lip = next(s for s in ROOM.solids if s.name == DOCK.name + CONTACTS)
    near = (DOCK.world_from_dock.inverse() @ lip.world_from_solid).x - 0.5 * lip.size_x
    assert math.isclose(near, 0.6 + LIP_GAP)
    assert lip.z_min < 0.04 < lip.z_max, "it is as low as the lower edge of the robot's body"


def simulation(start: SE2, *faults: str, solids: tuple[Solid, ...] = (), people: tuple[Person, ...] = ()) -> Simulation:
    """A robot that stands at a pose of the dock's frame."""
    world = load_world("dock_room", DOCK.world_from_dock @ start)
    world = replace(world, solids=world.solids + solids, people=people)
    config = SimulationConfig(physics="kinematic", faults=tuple(Fault.parse(f) for f in faults))
    return Simulation(world, robot_named("amr_omni"), config)


def seen(sim: Simulation) -> dict[int, float]:
    """Distance in millimetres between where a marker is seen and where it is, by the marker's number."""
    assert sim.camera is not None
    specs = [MarkerSpec(m.dictionary, m.number, m.size) for m in DOCK.markers]
    picture = sim.take_picture().data
    found = {s.marker.number: s for s in FiducialDetector(sim.camera.spec.model, specs).detect(picture)}
    world_from_camera = sim.world_from_base @ sim.robot.model.sensor(sim.camera.frame).base_from_sensor
    errors = {}
    for m, pose in zip(DOCK.markers, marker_poses(sim.world.docks[0]), strict=True):
        if m.number in found:
            at = (world_from_camera @ found[m.number].camera_from_marker).translation
            errors[m.number] = 1e3 * math.dist(at, pose.translation)
    return errors


def test_the_camera_shows_the_markers_where_they_are() -> None:
    errors = seen(simulation(SE2(-0.5, 0.03, 0.05)))
    assert set(errors) == {3, 5, 8}
    assert max(errors.values()) < 2.0
    assert set(seen(simulation(SE2()))) == {3, 5, 8}, "they fit into the picture of a docked robot"


def test_what_stands_between_hides_the_markers() -> None:
    board = Solid("board", Shape.BOX, DOCK.world_from_dock @ SE2(0.3, 0.0, 0.0), 0.02, 1.0, 0.0, 1.0)
    assert not seen(simulation(SE2(-0.5, 0.0, 0.0), solids=(board,)))
    low = replace(board, z_max=0.2)
    assert len(seen(simulation(SE2(-0.5, 0.0, 0.0), solids=(low,)))) == 3


def test_somebody_hides_exactly_what_is_behind_them() -> None:
    """A person of 0.5 m, 0.6 m before the camera, covers the middle; beside the line, one marker; behind the panel, nothing."""
    eye = SE2(-0.5, 0.0, 0.0)
    camera = robot_named("amr_omni").model.camera
    assert camera is not None
    at = eye.x + camera.base_from_sensor.translation[0] + 0.6
    for y, numbers in ((0.0, set()), (0.34, {3, 5}), (-0.34, {3, 8}), (0.9, {3, 5, 8})):
        spot = DOCK.world_from_dock @ SE2(at, y, 0.0)
        person = Person("somebody", ((spot.x, spot.y), (spot.x + 1e-3, spot.y)), 1e-6)  # who stands, nearly
        assert set(seen(simulation(eye, people=(person,)))) == numbers
    behind = DOCK.world_from_dock @ SE2(1.4, 0.0, 0.0)
    person = Person("somebody", ((behind.x, behind.y), (behind.x + 1e-3, behind.y)), 1e-6)
    assert len(seen(simulation(eye, people=(person,)))) == 3


@pytest.mark.parametrize(
    ("fault", "numbers"),
    [
        ("light", {3, 5, 8}),
        ("shadow", {3, 5, 8}),
        ("blur", {3, 5, 8}),
        ("occlusion", {5, 8}),
        ("marker_missing", {5, 8}),
    ],
)
def test_faults_of_the_picture(fault: str, numbers: set[int]) -> None:
    sim = simulation(SE2(-0.4, 0.0, 0.0), fault)
    clean = simulation(SE2(-0.4, 0.0, 0.0))
    for s in (sim, clean):
        s.step(1_000_000_000)
    picture, other = (s.take_picture().data.astype(float) for s in (sim, clean))
    assert np.abs(picture - other).mean() > 1.0, "the fault can be seen"
    assert numbers - {8} <= set(seen(sim)) <= numbers
    assert FaultKind(fault)


def test_pictures_are_the_same_for_the_same_seed() -> None:
    a, b = (simulation(SE2(-0.5, 0.0, 0.0)).take_picture() for _ in range(2))
    assert np.array_equal(a.data, b.data)


def test_without_docks_the_camera_sees_nothing_and_the_battery_drains() -> None:
    config = SimulationConfig(physics="kinematic")
    sim = Simulation(load_world("two_rooms"), robot_named("amr_omni"), config)
    picture = sim.take_picture().data
    assert picture.shape == (480, 640)
    assert picture.max() < 200, "no white of a marker"
    told = sim.step(3_000_000_000).batteries
    assert {b.supply for b in told} == {PowerSupply.DISCHARGING}
    assert told[-1].share < told[0].share
    with pytest.raises(RuntimeError, match="no camera"):
        Simulation(load_world("two_rooms"), robot_named("diff"), config).take_picture()


def test_a_dock_without_markers_is_refused(tmp_path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text("start: {x: 1, y: 1}\ndocks: [{name: d, pose: {x: 1, y: 1}, markers: []}]\n")
    with pytest.raises(BadInputError, match=r"docks\.0\.markers"):
        load_world(path)
    assert isinstance(ROOM, WorldSpec)


def returns_at(
    path: str | Path, dock: SimDock, dock_from_base: SE2, *faults: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points (N, 2) in the dock's frame and intensities (N,) of one turn of each front scanner, without noise."""
    config = SimulationConfig(is_perfect=True, physics="kinematic", faults=tuple(Fault.parse(f) for f in faults))
    start = dock.world_from_dock @ dock_from_base
    sim = Simulation(load_world(path, start), robot_named("amr_omni"), config)
    newest = {scan.frame: scan for scan in sim.step(200_000_000).scans}
    out = []
    for frame in ("front_left", "front_right"):
        scan, mount = newest[frame], sim.robot.model.sensor(frame).base_from_sensor
        points = dock_from_base.transform(scan_to_points(scan, mount, np.zeros(3), PlanarConfig()).points)
        out.append((points, scan.intensities[(scan.ranges >= 0.1) & (scan.ranges <= 30.0)]))
    return out


@pytest.mark.parametrize("angle_deg", [120.0, 150.0, 240.0])
def test_a_v_shape_stands_where_its_survey_says(angle_deg: float, tmp_path: Path) -> None:
    path = tmp_path / "v.yaml"
    leg = 0.3 if angle_deg == 150.0 else 0.34
    mark = f"{{angle_deg: {angle_deg:g}, leg: {leg:g}}}"
    path.write_text(f"extends: dock_room\ndocks: [{{name: v, pose: {{x: 3, y: 3}}, v_shape: {mark}}}]\n")
    dock = load_world(path).docks[-1]
    assert dock.v_shape is not None
    v, half = dock.v_shape, math.radians(0.5 * angle_deg)
    for x in (-0.8, 0.0):
        seen = [0, 0]
        for points, _ in returns_at(path, dock, SE2(x, 0.0, 0.0)):
            for k, side in enumerate((1.0, -1.0)):
                way = np.array([-math.cos(half), side * math.sin(half)])
                off = points - np.array([v.x, 0.0])
                along, across = off @ way, off @ np.array([-way[1], way[0]])
                on = (along > 0.1 * leg) & (along < 0.9 * leg) & (np.abs(across) < 0.015)
                assert np.abs(across[on]).max(initial=0.0) < 1e-4
                seen[k] += int(on.sum())
        assert min(seen) >= 25, "each leg is seen by one of the scanners, docked too"
    assert v.x - v.leg * min(0.0, math.cos(half)) > dock.front + LIP_GAP + 0.03, "the robot cannot touch it"


def test_only_reflectors_shine() -> None:
    dock = next(d for d in load_world("dock_shapes").docks if d.reflectors)
    least = DetectorConfig().intensity_min
    for x in (-0.9, 0.0):
        seen = returns_at("dock_shapes", dock, SE2(x, 0.0, 0.0))
        points, bright = (np.concatenate(part) for part in zip(*seen, strict=True))
        assert bright[bright < least].max() <= 1.0
        shining = points[bright >= least]
        assert np.abs(shining[:, 0] - (dock.panel - 0.5 * FILM)).max() < 0.51 * FILM
        for strip in dock.reflectors:
            on = np.abs(shining[:, 1] - strip.y) <= 0.5 * strip.width + 1e-4
            assert int(on.sum()) >= 6
            shining = shining[~on]
        assert len(shining) == 0
    for _, dull in returns_at("dock_shapes", dock, SE2(-0.9, 0.0, 0.0), "unmarked"):
        assert dull.max() <= 1.0
    assert not simulation(SE2(-0.5, 0.0, 0.0), "unmarked").world.docks[0].markers


@pytest.mark.parametrize(
    ("dock", "word"),
    [
        ("v_shape: {angle_deg: 175}", "angle_deg must be 60 to 160"),
        ("v_shape: {angle_deg: 20}", "angle_deg"),
        ("v_shape: {leg: 0.6}", "0.520 m aside"),
        ("v_shape: {leg: .nan}", "finite"),
        ("v_shape: {corner: 3}", "corner"),
        ("reflectors: [{y: 0.1}]", "at least 2"),
        ("reflectors: [{y: 0.1}, {y: 0.2}]", "nearer than 0.15 m"),
        ("reflectors: [{y: 0.1}, {y: 0.29}]", "does not fit"),
        ("reflectors: [{y: 0.1}, {x: 0.1}]", "reflectors"),
        ("front: 0.6", "exactly one of markers, v_shape, reflectors"),
        ("v_shape: {}, reflectors: [{y: 0.1}, {y: -0.1}]", "exactly one of"),
    ],
)
def test_bad_marks_are_refused_in_one_line(dock: str, word: str, tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(f"start: {{x: 1, y: 1}}\ndocks: [{{name: d, pose: {{x: 1, y: 1}}, {dock}}}]\n")
    with pytest.raises(BadInputError) as caught:
        load_world(path)
    text = str(caught.value)
    assert word in text
    assert "docks.0" in text
    assert "\n" not in text
