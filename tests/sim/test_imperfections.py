"""What is off in a real installation: within its bounds, in the truth alone, and where it belongs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.battery import Battery, BatterySpec
from ambler.sim.dock_body import marker_poses
from ambler.sim.imperfections import AROUND, NEAREST, PASSERBY, Tolerances, draw_imperfections
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.world_file import load_world

HALL = load_world("dock_hall")
DOCK = HALL.docks[0]
ROBOT = robot_named("amr_omni")
EXACT = draw_imperfections(0, DOCK, Tolerances(0, 0, 0, 0, 0, 0, 0, 0, (0.01, 0.01), (0.8, 0.8), 0.0, 0.0))


def test_what_is_drawn_fills_its_bounds_and_no_more() -> None:
    drawn = [draw_imperfections(seed, DOCK) for seed in range(400)]
    turn, share = math.radians(0.3), 0.003
    bounds: list[tuple[list[float], float]] = [
        ([v for d in drawn for v in d.camera_place], 0.002),
        ([v for d in drawn for v in d.camera_turn], turn),
        ([v for d in drawn for v in d.lens], share),
        ([v for d in drawn for flaw in d.markers for v in flaw.place], 0.001),
        ([v for d in drawn for flaw in d.markers for v in flaw.turn], turn),
        ([flaw.size for d in drawn for flaw in d.markers], share),
        ([d.contact for d in drawn], 0.001),
        ([v for d in drawn for v in d.tilt], turn),
    ]
    for values, bound in bounds:
        assert 0.98 * bound < max(values) <= bound
        assert -bound <= min(values) < -0.98 * bound
        assert abs(np.mean(values)) < 0.1 * bound
    assert 0.4 < np.mean([d.passer_by is not None for d in drawn]) < 0.6
    assert drawn[7] == draw_imperfections(7, DOCK)
    assert drawn[7] != drawn[8]


def test_nothing_off_changes_nothing() -> None:
    robot, world = EXACT.of_robot(replace(ROBOT, strafe_loss=0.0)), EXACT.of_world(HALL)
    assert robot.cameras == ROBOT.cameras
    mounts = [
        (a.base_from_sensor, b.base_from_sensor) for a, b in zip(robot.model.sensors, ROBOT.model.sensors, strict=True)
    ]
    assert all(np.allclose(a.matrix(), b.matrix(), atol=1e-12) for a, b in mounts)
    assert world.docks == HALL.docks
    assert world.terrain is not None
    assert np.abs(world.terrain.heights).max() < 1e-12


def test_only_the_camera_is_moved_and_ground() -> None:
    off = replace(
        EXACT,
        camera_place=(0.001, -0.002, 0.0005),
        camera_turn=(0.0, 0.0, math.radians(0.3)),
        lens=(0.003, -0.003, 0.0, 0.001),
    )
    robot = off.of_robot(ROBOT)
    for own, drawn in zip(robot.model.sensors, ROBOT.model.sensors, strict=True):
        if own.kind != "camera":
            assert own == drawn
            continue
        moved = np.subtract(own.base_from_sensor.translation, drawn.base_from_sensor.translation)
        assert np.allclose(moved, (0.001, -0.002, 0.0005), atol=1e-12)
        # It looks 0.3° farther to the left, in the base frame.
        ahead = own.base_from_sensor.rotate((0.0, 0.0, 1.0))
        assert math.degrees(math.atan2(ahead[1], ahead[0])) == pytest.approx(0.3, abs=1e-9)
    assert robot.cameras["camera"].model.fx == pytest.approx(1.003 * ROBOT.cameras["camera"].model.fx)
    assert robot.cameras["camera"].model.fy == pytest.approx(0.997 * ROBOT.cameras["camera"].model.fy)
    assert ROBOT.model.camera is not None


def test_markers_hang_beside_their_drawing_in_their_own_frame() -> None:
    flaw = replace(EXACT.markers[1], place=(0.001, 0.0, -0.0005), turn=(0.0, math.radians(0.3), 0.0), size=0.003)
    world = replace(EXACT, markers=(EXACT.markers[0], flaw, EXACT.markers[2])).of_world(HALL)
    drawn, built = marker_poses(DOCK), marker_poses(world.docks[0])
    assert drawn[0] == built[0]
    away = drawn[1].inverse() @ built[1]
    assert away.translation == pytest.approx((0.001, 0.0, -0.0005), abs=1e-12)
    assert math.degrees(2.0 * math.asin(away.rotation[2])) == pytest.approx(0.3, abs=1e-6)
    assert world.docks[0].markers[1].size == pytest.approx(1.003 * DOCK.markers[1].size)


@pytest.mark.parametrize(
    ("contact", "x", "meets"), [(0.001, -0.0005, False), (0.001, 0.0001, True), (-0.001, -0.0019, True)]
)
def test_the_switch_closes_deeper_or_earlier(contact: float, x: float, *, meets: bool) -> None:
    battery = Battery(BatterySpec(), [replace(DOCK, contact=contact)])
    battery.update(DOCK.world_from_dock @ SE2(x, 0.0, 0.0), 0.0, 0.005, has_power=True)
    assert battery.has_contact is meets


def test_a_docked_robot_leans_as_its_floor_does_and_the_floor_is_level_far_away() -> None:
    rise = (math.radians(0.3), math.radians(-0.2))
    world = replace(EXACT, tilt=rise).of_world(HALL)
    for k, (x, y) in enumerate(((0.0, 0.0), (-1.0, 0.0))):
        sim = Simulation(world, ROBOT, SimulationConfig(k), DOCK.world_from_dock @ SE2(x, y, 0.0))
        sim.command(BodyVelocity())
        sim.step(300_000_000)
        up = sim.world_from_base.rotate((0.0, 0.0, 1.0))
        assert math.degrees(-up[0]) == pytest.approx(0.3, abs=0.02)
        assert math.degrees(-up[1]) == pytest.approx(-0.2, abs=0.02)
    assert world.terrain is not None
    far = DOCK.world_from_dock.transform(np.array([[-9.0, -3.0], [-10.0, -3.0], [-9.0, -4.0]]))
    assert np.ptp(world.terrain.heights_at(far)) < 1e-4
    near = DOCK.world_from_dock.transform(np.array([[0.0, 0.0], [AROUND, 0.0], [-AROUND, AROUND]]))
    expected = [0.0, AROUND * math.tan(rise[0]), AROUND * (math.tan(rise[1]) - math.tan(rise[0]))]
    assert world.terrain.heights_at(near) == pytest.approx(expected, abs=1e-9)


def test_somebody_walks_beside_the_dock_but_not_where_the_robot_starts() -> None:
    off = replace(EXACT, passer_by=(0.1, 1.0, -1.0))
    world = off.of_world(HALL)
    (person,) = world.people
    assert person.name == PASSERBY
    ends = DOCK.world_from_dock.inverse().transform(np.array(person.way))
    assert ends[:, 0] == pytest.approx([0.1, 0.1])
    assert ends[0, 1] == pytest.approx(-NEAREST)
    assert ends[1, 1] < -2.0
    for solid in HALL.solids:
        local = solid.world_from_solid.inverse().transform(np.linspace(*np.array(person.way), 50))
        half = 0.5 * np.array([solid.size_x, solid.size_y])
        assert solid.z_min > 1.7 or np.hypot(*np.maximum(np.abs(local) - half, 0.0).T).min() > 0.25
    assert off.beginning_at(SE2(-8.0, 0.0, 0.0)) == off
    assert off.beginning_at(SE2(0.3, 2.0, 0.0)) == off
    assert off.beginning_at(SE2(0.3, -2.0, 0.0)).passer_by is None


def test_a_world_without_the_dock_is_refused_and_all_is_told() -> None:
    with pytest.raises(KeyError, match="charger_1"):
        EXACT.of_world(load_world("two_rooms"))
    told = draw_imperfections(3, DOCK).told()
    assert {"camera_turn_z_deg", "lens_fx", "marker2_size", "contact_mm", "floor_x_deg", "slip"} <= set(told)
    assert all(isinstance(value, float | bool) for value in told.values())
