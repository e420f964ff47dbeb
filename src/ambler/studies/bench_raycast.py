"""Rays of one VLP-16 turn and one 720-beam scan beside MuJoCo's rays, and the cost of a simulated second.

Times are CPU time of this thread, medians, so that other work on the machine disturbs little.
"""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.kernels import raycast
from ambler.sim.base import PlacedRobot
from ambler.sim.body import TICK
from ambler.sim.contact_physics import build_mjcf
from ambler.sim.lidar import LidarSensor
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.scene import RayScene, build_scene
from ambler.sim.sensors import SCANNER_360, VLP_16, LidarSpec
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import load_world
from ambler.studies.timing import median_ms

PLACES = 10
SECONDS = 5


def measure(world_name: str, seed: int) -> dict[str, Any]:
    """Return the times of rays in a world, built-in or a file, and of the whole simulator there."""
    raycast.warm_up()
    world = load_world(world_name).from_start()
    scene = build_scene(world)
    vlp = median_sweep_ms(VLP_16, scene, 0.78)
    peer = median_mujoco_ms(VLP_16, world, 0.78)
    rays = VLP_16.columns * len(VLP_16.elevations)
    fields: dict[str, Any] = {
        "solids": len(world.solids),
        "vlp16_turn_ms": vlp,
        "vlp16_mrays_per_s": rays / vlp * 1e-3,
        "scan720_ms": median_sweep_ms(SCANNER_360, scene, 0.28),
        "peer_mujoco_vlp16_ms": peer,
        "ratio_vs_mujoco": peer / vlp,
    }
    for robot in robot_names():
        for physics in ("contact", "kinematic"):
            fields[f"{robot}_{physics}_cpu_ms_per_s"] = cpu_ms_per_second(world, robot, physics, seed)
    return fields


def median_sweep_ms(spec: LidarSpec, scene: RayScene, height: float) -> float:
    """Time one turn of a moving scanner with its noise, at the start of the world."""
    sensor = LidarSensor(spec, "bench", scene, 0)
    times = np.linspace(0.0, spec.period, 21)
    quaternions = np.column_stack([np.cos(0.5 * times), 0 * times, 0 * times, np.sin(0.5 * times)])
    positions = np.column_stack([0.5 * times, 0 * times, height + 0 * times])
    return median_ms(lambda: sensor.sweep(times, positions, quaternions), 4 * PLACES, time.thread_time)


def median_mujoco_ms(spec: LidarSpec, world: WorldSpec, height: float) -> float:
    """Time the same rays with `mj_multiRay`, all from one origin."""
    model: Any = mujoco.MjModel.from_xml_string(
        build_mjcf(world, [PlacedRobot("robot", robot_named("diff"), SE2())], TICK)
    )
    data: Any = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    directions = spec.directions().reshape(-1, 3)
    n, origin = len(directions), np.array([0.0, 0.0, height])
    geoms, distance = np.zeros(n, np.int32), np.zeros(n)
    base = int(model.body("robot/base").id)
    vectors = np.ascontiguousarray(directions.ravel())
    return median_ms(
        lambda: mujoco.mj_multiRay(
            model, data, origin, vectors, None, 1, base, geoms, distance, None, n, spec.range_max
        ),
        PLACES,
        time.thread_time,
    )


def cpu_ms_per_second(world: WorldSpec, robot: str, physics: str, seed: int) -> float:
    """CPU milliseconds of a simulated second: physics, all sensors with noise, ground truth, while driving."""
    config = SimulationConfig(seed, physics="contact" if physics == "contact" else "kinematic")
    simulation = Simulation(world, robot_named(robot), config)
    simulation.step(500_000_000)
    start = time.thread_time()
    for k in range(SECONDS * 100):
        simulation.command(BodyVelocity(0.2, 0.0, 0.3 if k // 200 % 2 else -0.3))
        simulation.step(500_000_000 + (k + 1) * 10_000_000)
    return 1e3 * (time.thread_time() - start) / SECONDS
