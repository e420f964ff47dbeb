"""Contact and rays on meshes and height fields of more and more triangles, beside the plain floor.

All grounds are flat and 10 x 10 m, so that a robot's way on them must be that on the floor. Times are CPU time of this thread.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.kernels import bvh, raycast
from ambler.sim.base import PlacedRobot
from ambler.sim.body import TICK
from ambler.sim.contact_physics import ContactPhysics
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.sensors import VLP_16
from ambler.sim.solids import WorldSpec
from ambler.studies.bench_raycast import median_sweep_ms

SIZE = 10.0
STEPS = 600
CELLS = {"mesh": (22, 71), "field": (22, 71, 200)}


def measure(robot: str, seed: int) -> dict[str, Any]:
    """Drive a robot over every ground; returns CPU times, and how far its way differs from that on the floor."""
    raycast.warm_up()
    bvh.warm_up()
    worlds = {"plane": WorldSpec("plane", (), SE2())}
    for kind, sizes in CELLS.items():
        for cells in sizes:
            worlds[f"{kind}_{2 * cells * cells}"] = flat_ground(kind, cells, seed)
    fields: dict[str, Any] = {"robot": robot}
    plain = None
    for name, world in worlds.items():
        way, measured = drive(world, robot)
        plain = way if plain is None else plain
        fields |= {f"{name}_{key}": value for key, value in measured.items()}
        fields[f"{name}_way_differs_mm"] = 1e3 * float(np.linalg.norm(way - plain))
        fields[f"{name}_vlp16_turn_ms"] = turn_ms(world)
    return fields


def flat_ground(kind: str, cells: int, seed: int) -> WorldSpec:
    """Return a world whose level ground of `cells` x `cells` squares is a `mesh` of uneven triangles or a height `field`."""
    if kind == "mesh":
        return WorldSpec("mesh", (), SE2(), meshes=(_uneven_mesh(cells, seed),))
    corner = SE2(-0.5 * SIZE, -0.5 * SIZE, 0.0)
    field = HeightField("field", np.full((cells + 1, cells + 1), 0.1), SIZE / cells, corner)
    return WorldSpec("field", (), SE2(), terrain=field)


def _uneven_mesh(cells: int, seed: int) -> TriangleMesh:
    """A level mesh 0.1 m above the floor, each vertex up to 0.3 cells away from its place in the grid."""
    line = np.linspace(-0.5 * SIZE, 0.5 * SIZE, cells + 1)
    x, y = np.meshgrid(line, line)
    shift = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, *x.shape)) * (SIZE / cells)
    vertices = np.stack([x + shift[0], y + shift[1], np.full_like(x, 0.1)], axis=-1).reshape(-1, 3)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    b, c, d = a + 1, a + cells + 2, a + cells + 1
    return TriangleMesh("mesh", vertices, np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3))


def drive(world: WorldSpec, robot: str) -> tuple[Any, dict[str, float]]:
    """Drive ahead at 0.4 m/s; returns the way float64 (3,), and the times of building the model and of a step."""
    start = time.thread_time()
    physics = ContactPhysics(world, [PlacedRobot("robot", robot_named(robot), world.start)], TICK)
    build = time.thread_time() - start
    begin, times = np.array(physics.carriage(0).position), []
    for _ in range(STEPS):
        start = time.thread_time()
        physics.step([BodyVelocity(0.4, 0.0, 0.0)])
        times.append(time.thread_time() - start)
    way = np.array(physics.carriage(0).position) - begin
    return way, {"build_ms": 1e3 * build, "step_us": 1e6 * statistics.median(times)}


def turn_ms(world: WorldSpec) -> float:
    """Time one turn of a moving VLP-16 over the ground."""
    return median_sweep_ms(VLP_16, build_scene(world), 0.88)
