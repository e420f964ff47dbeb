"""Sound against geometry: the nearest surface of the cone counts, glass too, flat ones do not; and light's specular peak on glass."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Range
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.sensors import TRANSDUCER_30
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.ultrasonic import UltrasonicSensor, with_ultrasonic_ring

PERFECT = TRANSDUCER_30.perfect()
PANE = Solid("pane", Shape.BOX, SE2(2.0, 0.0, 0.0), 0.02, 8.0, 0.0, 2.5, is_glass=True)
WALL = Solid("wall", Shape.BOX, SE2(4.25, 0.0, 0.0), 0.5, 40.0, 0.0, 2.5)
HALF = 0.5 * PERFECT.field_of_view


def heard(solids: tuple[Solid, ...], yaw: float = 0.0, x: float = 0.0, z: float = 0.2) -> float:
    sensor = UltrasonicSensor(PERFECT, "sonar", build_scene(WorldSpec("w", solids, SE2())), 0)
    return sensor.measure(SE3.from_rpy((x, 0.0, z), 0.0, 0.0, yaw), 0).range


def nearest_in_cone(points: np.ndarray, yaw: float) -> float:
    """Slow twin: of many points of a surface, the nearest one inside the cone."""
    off = np.abs(
        np.arctan2(
            np.hypot(points[:, 1] * math.cos(yaw) - points[:, 0] * math.sin(yaw), points[:, 2] - 0.2),
            points[:, 0] * math.cos(yaw) + points[:, 1] * math.sin(yaw),
        )
    )
    distance = np.linalg.norm(points - [0.0, 0.0, 0.2], axis=1)
    return float(distance[off <= HALF].min(initial=math.inf))


@pytest.mark.parametrize("yaw_deg", [0, 10, 15, 25, 40, 60, 70])
def test_the_range_is_that_of_the_nearest_point_in_the_cone_even_of_glass(yaw_deg: int) -> None:
    yaw = math.radians(yaw_deg)
    y, z = np.meshgrid(np.linspace(-4, 4, 2001), np.linspace(0, 2.5, 251))
    surface = np.stack([np.full(y.size, 1.99), y.ravel(), z.ravel()], axis=1)
    expected = nearest_in_cone(surface, yaw)
    if expected > PERFECT.range_max:
        assert heard((PANE, WALL), yaw) == math.inf
    else:
        assert heard((PANE, WALL), yaw) == pytest.approx(expected, rel=0.006)
        assert heard((replace(PANE, is_glass=False), WALL), yaw) == heard((PANE, WALL), yaw)


def test_flat_surfaces_and_the_floor_throw_the_sound_away() -> None:
    beside = Solid("beside", Shape.BOX, SE2(0.0, 0.5, 0.0), 40.0, 0.1, 0.0, 2.5)
    assert heard((beside,)) == math.inf, "a wall along the way, met flatter than 65 degrees by every ray of the cone"
    assert heard((), z=0.2) == math.inf, "the floor"
    assert heard((beside,), math.pi / 2) == pytest.approx(0.45, abs=1e-3)


def test_nearer_than_the_range_is_told_as_such() -> None:
    assert heard((PANE,), x=1.98) == -math.inf
    assert heard((PANE,), x=1.94) == pytest.approx(0.05, abs=1e-3)
    assert heard(()) == math.inf


def test_noise_losses_and_crosstalk_come_as_often_as_they_should() -> None:
    spec = replace(TRANSDUCER_30, dropout=0.05, crosstalk=0.05)
    sensor = UltrasonicSensor(spec, "sonar", build_scene(WorldSpec("w", (PANE,), SE2())), 3)
    ranges = np.array([sensor.measure(SE3((0.0, 0.0, 0.2)), 0).range for _ in range(3000)])
    good = np.abs(ranges - 1.99) < 0.06
    assert np.mean(np.isinf(ranges)) == pytest.approx(0.05, abs=0.015)
    assert np.mean(np.isfinite(ranges) & ~good) == pytest.approx(0.05 * 1.93 / 2.97, abs=0.015)
    assert np.std(ranges[good]) == pytest.approx(0.01, rel=0.1)
    assert np.mean(ranges[good]) == pytest.approx(1.99, abs=0.002)


@pytest.mark.parametrize("name", ["diff", "amr_omni"])
def test_a_ring_sits_on_the_outline_and_looks_all_around(name: str) -> None:
    robot = robot_named(f"{name}+ultrasonic")
    assert len(robot.model.rangers) == len(robot.ultrasonics) == 12
    footprint = robot.model.footprint
    for k, mount in enumerate(robot.model.rangers):
        x, y, z = mount.base_from_sensor.translation
        a, b = footprint, np.roll(footprint, -1, axis=0)
        edge = b - a
        inside = edge[:, 0] * (y - a[:, 1]) - edge[:, 1] * (x - a[:, 0])
        assert np.min(inside / np.hypot(*edge.T)) == pytest.approx(0.0, abs=1e-12)
        yaw = mount.base_from_sensor.to_se2().yaw
        assert yaw == pytest.approx(math.remainder(math.radians(30.0 * k), 2 * math.pi))
        assert math.atan2(y, x) == pytest.approx(yaw)
        assert 0.0 < z < robot.model.body_height
    with pytest.raises(BadInputError):
        with_ultrasonic_ring(robot)
    with pytest.raises(BadInputError, match="no option"):
        robot_named(f"{name}+radar")


def drive(robot: str, seconds: float = 1.0, faults: tuple[str, ...] = ()) -> list[Range]:
    world = WorldSpec("w", (PANE, WALL), SE2())
    config = SimulationConfig(5, physics="kinematic", faults=tuple(Fault.parse(f) for f in faults))
    simulation = Simulation(world, robot_named(robot), config)
    out = []
    while simulation.now_ns < seconds * 1e9:
        simulation.command(BodyVelocity(0.5, 0.0, 0.1))
        out += simulation.step(simulation.now_ns + 50_000_000).ranges
    return out


def test_every_transducer_fires_in_its_group_and_two_runs_are_equal() -> None:
    ranges = drive("diff+ultrasonic")
    assert not drive("diff")
    by_frame = {f"sonar_{k}": [r.stamp_ns for r in ranges if r.frame == f"sonar_{k}"] for k in range(12)}
    for k, stamps in by_frame.items():
        assert set(np.diff(stamps)) == {80_000_000}, k
    assert by_frame["sonar_1"][0] == 20_000_000
    assert by_frame["sonar_5"] == by_frame["sonar_1"]
    again = drive("diff+ultrasonic")
    assert [(r.stamp_ns, r.frame, r.range) for r in again] == [(r.stamp_ns, r.frame, r.range) for r in ranges]


def test_a_ring_changes_no_other_sensor() -> None:
    world, scans = WorldSpec("w", (WALL,), SE2()), []
    for name in ("diff", "diff+ultrasonic"):
        simulation = Simulation(world, robot_named(name), SimulationConfig(2, physics="kinematic"))
        scans.append(simulation.step(500_000_000).scans[-1].ranges)
    np.testing.assert_array_equal(*scans)


def test_a_transducer_falls_silent_on_demand() -> None:
    ranges = drive("diff+ultrasonic", faults=("scanner_dropout@sonar_0:0.3:0.6",))
    front = np.array([r.stamp_ns for r in ranges if r.frame == "sonar_0"])
    assert not ((front >= 300_000_000) & (front < 600_000_000)).any()
    assert (front >= 600_000_000).any()
    assert sum(300_000_000 <= r.stamp_ns < 600_000_000 for r in ranges if r.frame == "sonar_1") >= 3


def test_glass_shines_only_where_light_meets_it_squarely() -> None:
    simulation = Simulation(WorldSpec("w", (PANE, WALL), SE2()), robot_named("diff"), SimulationConfig(0, True))
    scan = simulation.step(100_000_000).scans[0]
    angles = scan.angle_min + np.arange(720) * scan.angle_increment
    off = np.abs(angles)
    assert scan.intensities[np.argmin(off)] == pytest.approx(4.06, abs=0.01)
    assert scan.intensities[np.argmin(np.abs(angles - math.radians(5)))] == pytest.approx(
        0.06 + 4.0 * math.exp(-2.0), abs=0.02
    )
    assert (scan.intensities[(off > math.radians(9)) & (off < math.radians(11.5))] < 0.08).all()
    through = (off > math.radians(13)) & (off < 1.0)
    np.testing.assert_allclose(scan.intensities[through], 0.6 * np.cos(angles[through]), atol=1e-3)
