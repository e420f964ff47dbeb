"""The whole simulation: equal bits for equal seeds, the right rates and stamps, and the frames of ground truth."""

from dataclasses import fields

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Message
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.simulation import Simulation, SimulationConfig, SimulationOutput
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import load_world


def run(robot: str, seed: int, step_ns: int = 10_000_000, mode: str = "contact") -> SimulationOutput:
    config = SimulationConfig(seed, physics="contact" if mode == "contact" else "kinematic")
    simulation = Simulation(load_world("lab_obstacle"), robot_named(robot), config)
    out = SimulationOutput()
    for k in range(0, 600_000_000, 100_000_000):
        simulation.command(BodyVelocity(0.5, 0.1, 0.4 - k * 1e-9))
        for until in range(k + step_ns, k + 100_000_001, step_ns):
            part = simulation.step(until)
            for f in fields(out):
                getattr(out, f.name).extend(getattr(part, f.name))
    return out


def bits(message: Message) -> list[object]:
    values = [getattr(message, f.name) for f in fields(message)]  # type: ignore[arg-type]
    return [v.tobytes() if isinstance(v, np.ndarray) else v for v in values]


def equal(a: SimulationOutput, b: SimulationOutput) -> bool:
    return all(
        [bits(m) for m in getattr(a, f.name)] == [bits(m) for m in getattr(b, f.name)] for f in fields(SimulationOutput)
    )


@pytest.mark.parametrize("mode", ["contact", "kinematic"])
@pytest.mark.parametrize("robot", robot_names())
def test_one_seed_gives_equal_bits_and_another_does_not(robot: str, mode: str) -> None:
    first = run(robot, 4, mode=mode)
    assert equal(first, run(robot, 4, mode=mode))
    other = run(robot, 5, mode=mode)
    for name in ("scans", "clouds", "imus", "odometry"):
        for a, b in zip(getattr(first, name)[-2:], getattr(other, name)[-2:], strict=True):
            assert bits(a) != bits(b)


@pytest.mark.parametrize("step_ns", [5_000_000, 50_000_000, 100_000_000])
def test_the_caller_may_cut_time_as_it_likes(step_ns: int) -> None:
    assert equal(run("diff", 1), run("diff", 1, step_ns))


def test_rates_and_stamps_are_those_of_the_data_sheets() -> None:
    out = run("diff", 0)
    assert [s.stamp_ns for s in out.scans] == [k * 100_000_000 for k in range(6)]
    assert [o.stamp_ns for o in out.odometry] == [k * 20_000_000 for k in range(31)]
    assert [o.stamp_ns for o in out.true_poses] == [k * 20_000_000 for k in range(31)]
    assert [i.stamp_ns for i in out.imus] == [5_000_000 + k * 10_000_000 for k in range(60)]
    scan = out.scans[0]
    assert isinstance(scan, LaserScan)
    assert len(scan.ranges) == 720
    assert scan.time_increment * 720 == pytest.approx(scan.scan_time)
    cloud = run("spot", 0).clouds[0]
    assert cloud.frame == "velodyne"
    assert cloud.time.max() < 0.1


def test_a_late_start_only_shifts_the_stamps() -> None:
    early = Simulation(load_world("lab_empty"), robot_named("diff"))
    late = Simulation(load_world("lab_empty"), robot_named("diff"), begin_ns=1_234_567_891)
    a, b = early.step(300_000_000), late.step(1_234_567_891 + 300_000_000)
    assert [m.stamp_ns + 1_234_567_891 for m in a.imus] == [m.stamp_ns for m in b.imus]
    np.testing.assert_array_equal(a.scans[1].ranges, b.scans[1].ranges)


def test_truth_begins_at_the_start_and_tells_the_twist(open_floor: WorldSpec) -> None:
    simulation = Simulation(open_floor, robot_named("diff"))
    first = simulation.step(0).true_poses[0]
    assert (first.frame, first.child) == ("world", "base")
    assert first.pose.to_se2().distance_to(SE2()) == 0.0
    for _ in range(40):
        simulation.command(BodyVelocity(0.5, 0.0, 0.5))
        out = simulation.step(simulation.now_ns + 50_000_000)
    truth = out.true_poses[-1]
    np.testing.assert_allclose(truth.linear, (0.5, 0.0, 0.0), atol=0.01)
    np.testing.assert_allclose(truth.angular, (0.0, 0.0, 0.5), atol=0.01)


def test_scans_fit_the_true_map_from_the_true_pose() -> None:
    """A perfect, standing scanner: every return lies on a surface of the world, told in the world."""
    world, robot = load_world("office"), robot_named("diff")
    simulation = Simulation(world, robot, SimulationConfig(is_perfect=True))
    scan = simulation.step(100_000_000).scans[0]
    angles = scan.angle_min + np.arange(720) * scan.angle_increment
    hit = np.isfinite(scan.ranges)
    points = scan.ranges[hit, None] * np.column_stack([np.cos(angles[hit]), np.sin(angles[hit])])
    world_from_laser = world.start @ robot.model.sensor("laser").base_from_sensor.to_se2()
    points_world = world_from_laser.transform(points)
    gaps = []
    for solid in world.solids:
        local = solid.world_from_solid.inverse().transform(points_world)
        if solid.z_min <= 0.28 <= solid.z_max:
            half = 0.5 * np.array([solid.size_x, solid.size_y])
            beyond = np.abs(local) - half if solid.shape == 0 else np.hypot(*local.T)[:, None] - half[:1]
            gaps.append(np.abs(beyond.max(axis=1)))
    assert np.min(gaps, axis=0).max() < 2e-3
