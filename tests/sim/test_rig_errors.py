"""Plates that are a little off, and inertial units whose axes lean, whose counts are whole and which shake."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se3 import SE3
from ambler.sim.imu import GRAVITY, ImuSensor
from ambler.sim.rig_errors import EXACT, RigErrors, as_built, draw_flaw
from ambler.sim.robots import robot_named
from ambler.sim.sensors import ICM_40609, ImuSpec
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.world_file import load_world

QUIET = ICM_40609.perfect()


def measured(
    spec: ImuSpec, rate: tuple[float, float, float] = (0.0, 0.0, 0.0), speed: float = 0.0, count: int = 400
) -> np.ndarray:
    """Rates and forces (count, 6) of a level unit that turns and goes evenly."""
    sensor, period, rows = ImuSensor(spec, "imu", 3), 1.0 / spec.rate_hz, []
    size = math.hypot(*rate)
    axis = np.array(rate) / size if size else np.zeros(3)
    for k in range(count + 1):
        half = 0.5 * size * k * period
        x, y, z = (math.sin(half) * axis).tolist()
        told = sensor.update(SE3((0.0, 0.0, 0.0), (math.cos(half), x, y, z)), (speed, 0.0, 0.0), k)
        if told is not None:
            rows.append((*told.angular_velocity, *told.linear_acceleration))
    return np.array(rows)


def test_axes_that_lean_feel_a_share_of_each_others_rates() -> None:
    square = measured(QUIET, (0.0, 0.0, 1.0))
    leaning = measured(replace(QUIET, misalignment=math.radians(0.5)), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(square[:, :3], [[0.0, 0.0, 1.0]] * len(square), atol=1e-9)
    shares = leaning[:, :2]
    assert np.ptp(shares, axis=0) == pytest.approx(0.0, abs=1e-9), "the same all the time"
    assert (np.abs(shares[0]) > 1e-5).all()
    assert np.abs(shares[0]).max() < 4.0 * math.radians(0.5)
    assert leaning[0, 2] == pytest.approx(1.0)
    np.testing.assert_allclose(measured(replace(QUIET, misalignment=1e-3))[:, 5], GRAVITY, atol=1e-9)


def test_counts_are_whole_and_end_at_the_limit() -> None:
    spec = replace(QUIET, gyro_step=ICM_40609.gyro_step, accel_step=ICM_40609.accel_step)
    rows = measured(spec, (0.1, 0.2, 0.3))
    for part, step in ((rows[:, :3], spec.gyro_step), (rows[:, 3:], spec.accel_step)):
        np.testing.assert_allclose(part / step, np.round(part / step), atol=1e-6)
    assert abs(rows[0, 1] - 0.2) <= 0.5 * spec.gyro_step
    fast = measured(spec, (50.0, 0.0, 0.0))
    assert fast[:, 0].max() == pytest.approx(spec.gyro_limit, abs=spec.gyro_step)


def test_shaking_grows_with_speed() -> None:
    spec = replace(QUIET, vibration=0.3)
    still, slow, fast = (measured(spec, speed=speed)[1:] for speed in (0.0, 0.5, 1.0))
    assert np.std(still[:, 3:]) == pytest.approx(np.std([[0.0, 0.0, GRAVITY]]), abs=1e-9)
    for rows, speed in ((slow, 0.5), (fast, 1.0)):
        assert np.std(rows[:, 3:], axis=0) == pytest.approx([0.3 * speed] * 3, rel=0.15)
        assert np.std(rows[:, :3], axis=0) == pytest.approx([0.03 * speed] * 3, rel=0.15)


def test_a_plate_is_off_by_what_its_seed_draws_and_the_drawing_is_not() -> None:
    robot = robot_named("go2")
    flaws = [draw_flaw(seed, RigErrors()) for seed in range(400)]
    places = np.array([f.drawn_from_built.translation for f in flaws])
    assert np.std(places, axis=0) == pytest.approx([0.002] * 3, rel=0.15)
    assert np.std([f.clock for f in flaws]) == pytest.approx(0.0005, rel=0.15)
    a, b, c = as_built(robot, 1), as_built(robot, 1), as_built(robot, 2)
    assert a.lidars == b.lidars != c.lidars
    assert a.model.sensor("livox") == b.model.sensor("livox") != robot.model.sensor("livox")
    assert a.model.sensor("imu") == robot.model.sensor("imu")
    exact = as_built(robot, 1, EXACT)
    assert exact.lidars == robot.lidars
    between = exact.model.sensor("livox").base_from_sensor.inverse() @ robot.model.sensor("livox").base_from_sensor
    assert between.translation == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_a_late_clock_tells_stamps_before_the_points_were_seen() -> None:
    robot = robot_named("mecanum")
    late = replace(robot, lidars={"livox": replace(robot.lidars["livox"], clock=0.004)})
    clouds = [Simulation(load_world("office"), r, SimulationConfig(1)).step(500_000_000).clouds for r in (robot, late)]
    for right, behind in zip(*clouds, strict=True):
        assert right.stamp_ns - behind.stamp_ns == 4_000_000
        np.testing.assert_array_equal(right.points, behind.points)
