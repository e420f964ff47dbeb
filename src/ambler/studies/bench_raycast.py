"""`ambler bench raycast`: rays of one VLP-16 turn and one 720-beam scan beside MuJoCo's rays, and the cost of a simulated second.

Times are CPU time of this thread, medians, so that other work on the machine disturbs little.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from ambler.sim.scene import RayScene
    from ambler.sim.sensors import LidarSpec
    from ambler.sim.solids import WorldSpec

PLACES = 10
SECONDS = 5


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "raycast", help="the simulator's ray caster beside MuJoCo's, and the whole simulator"
    )
    parser.add_argument("--world", default="office", help="name of a world, or a world or floor plan file (.yaml)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print; always 0."""
    from ambler.evaluation.results import write_results
    from ambler.kernels import raycast
    from ambler.sim.robots import robot_names
    from ambler.sim.scene import build_scene
    from ambler.sim.sensors import SCANNER_360, VLP_16
    from ambler.sim.world_file import load_world

    begin = time.perf_counter()
    raycast.warm_up()
    world = load_world(args.world).from_start()
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
            fields[f"{robot}_{physics}_cpu_ms_per_s"] = cpu_ms_per_second(world, robot, physics, args.seed)
    for key, value in fields.items():
        print(f"{key:32} {value:.3f}")
    if args.json is not None:
        rounded = {k: round(v, 4) for k, v in fields.items()}
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, rounded)
    return 0


def median_ms(call: Callable[[], object], repeats: int) -> float:
    """Return the median CPU time of a call in milliseconds."""
    import statistics

    times = []
    for _ in range(repeats):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
    return 1e3 * statistics.median(times)


def median_sweep_ms(spec: LidarSpec, scene: RayScene, height: float) -> float:
    """Time one turn of a moving scanner with its noise, at the start of the world."""
    import numpy as np

    from ambler.sim.lidar import LidarSensor

    sensor = LidarSensor(spec, "bench", scene, 0)
    times = np.linspace(0.0, spec.period, 21)
    quaternions = np.column_stack([np.cos(0.5 * times), 0 * times, 0 * times, np.sin(0.5 * times)])
    positions = np.column_stack([0.5 * times, 0 * times, height + 0 * times])
    return median_ms(lambda: sensor.sweep(times, positions, quaternions), 4 * PLACES)


def median_mujoco_ms(spec: LidarSpec, world: WorldSpec, height: float) -> float:
    """Time the same rays with `mj_multiRay`, all from one origin."""
    import mujoco
    import numpy as np

    from ambler.core.se2 import SE2
    from ambler.sim.base import PlacedRobot
    from ambler.sim.body import TICK
    from ambler.sim.contact_physics import build_mjcf
    from ambler.sim.robots import robot_named

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
    )


def cpu_ms_per_second(world: WorldSpec, robot: str, physics: str, seed: int) -> float:
    """CPU milliseconds of a simulated second: physics, all sensors with noise, ground truth, while driving."""
    from ambler.core.protocols import BodyVelocity
    from ambler.sim.robots import robot_named
    from ambler.sim.simulation import Simulation, SimulationConfig

    config = SimulationConfig(seed, physics="contact" if physics == "contact" else "kinematic")
    simulation = Simulation(world, robot_named(robot), config)
    simulation.step(500_000_000)
    start = time.thread_time()
    for k in range(SECONDS * 100):
        simulation.command(BodyVelocity(0.2, 0.0, 0.3 if k // 200 % 2 else -0.3))
        simulation.step(500_000_000 + (k + 1) * 10_000_000)
    return 1e3 * (time.thread_time() - start) / SECONDS
