"""The ray caster against geometry done by hand, a brute-force NumPy twin, and MuJoCo's rays in every world."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import raycast
from ambler.sim.base import PlacedRobot
from ambler.sim.contact_physics import build_mjcf
from ambler.sim.lidar import LidarSensor
from ambler.sim.robots import robot_named
from ambler.sim.scene import RayScene, build_scene
from ambler.sim.sensors import SCANNER_360, VLP_16
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.truth import reachable_cells
from ambler.sim.world_file import load_world, world_names

F64 = NDArray[np.float64]


def unit(vectors: F64) -> F64:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def random_world(rng: np.random.Generator, count: int) -> WorldSpec:
    solids = []
    for k in range(count):
        pose = SE2(*rng.uniform(-8, 8, 2), rng.uniform(-3, 3))
        z = rng.uniform(0, 1)
        size = rng.uniform(0.1, 2.0, 3)
        shape = Shape.CYLINDER if k % 3 == 0 else Shape.BOX
        if shape is Shape.CYLINDER:
            size[1] = size[0]
        solids.append(Solid(f"s{k}", shape, pose, size[0], size[1], z, z + size[2]))
    return WorldSpec("random", tuple(solids), SE2(), ceiling=4.0)


def slow_cast(world: WorldSpec, origin: F64, direction: F64) -> float:
    """The nearest surface by marching nothing and pruning nothing: every face of every solid, one by one."""
    best = math.inf
    for z in (0.0, world.ceiling):
        if direction[2] != 0 and (t := (z - origin[2]) / direction[2]) > 0:
            best = min(best, t)
    for s in world.solids:
        turn = SE2(0, 0, -s.world_from_solid.yaw)
        o = np.append(turn.transform((origin[:2] - [s.world_from_solid.x, s.world_from_solid.y])[None])[0], origin[2])
        d = np.append(turn.transform(direction[None, :2])[0], direction[2])
        candidates = [(z - o[2]) / d[2] for z in (s.z_min, s.z_max)]
        hx, hy = 0.5 * s.size_x, 0.5 * s.size_y
        if s.shape is Shape.BOX:
            candidates += [(sign * h - o[j]) / d[j] for j, h in ((0, hx), (1, hy)) for sign in (-1, 1)]
        else:
            a, b, c = d[0] ** 2 + d[1] ** 2, o[:2] @ d[:2], o[:2] @ o[:2] - hx**2
            if b * b - a * c >= 0:
                candidates += [(-b + sign * math.sqrt(b * b - a * c)) / a for sign in (-1, 1)]
        for t in candidates:
            p = o + t * d
            inside = abs(p[0]) <= hx + 1e-9 and abs(p[1]) <= hy + 1e-9
            if s.shape is Shape.CYLINDER:
                inside = p[0] ** 2 + p[1] ** 2 <= hx * hx + 1e-9
            if t >= 0 and inside and s.z_min - 1e-9 <= p[2] <= s.z_max + 1e-9:
                best = min(best, t)
    return best


def test_distances_done_by_hand(wall_ahead: WorldSpec) -> None:
    scene = build_scene(wall_ahead)
    origins = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1]])
    slant = unit(np.array([[1.0, 1.0, 0.0]]))[0]
    directions = np.array([[1.0, 0, 0], slant, [-1, 0, 0], [0, 0, -1], [0, 0, 1]])
    distance, hit, cosine = scene.cast(origins, directions)
    np.testing.assert_allclose(distance, [3.0, 3.0 * math.sqrt(2), np.inf, 1.0, np.inf], atol=1e-9)
    assert hit.tolist() == [0, 0, raycast.NOTHING, raycast.FLOOR, raycast.NOTHING]
    np.testing.assert_allclose(cosine[[0, 1, 3]], [1.0, math.sqrt(0.5), 1.0], atol=1e-9)


def test_cylinder_done_by_hand() -> None:
    column = Solid("column", Shape.CYLINDER, SE2(2.0, 0.0, 0.3), 1.0, 1.0, 0.0, 1.0)
    scene = build_scene(WorldSpec("column", (column,), SE2()))
    origins = np.array([[0.0, 0.0, 0.5], [0.0, 0.3, 0.5], [2.0, 0.0, 3.0], [0.0, 0.6, 0.5]])
    directions = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 0, -1.0], [1.0, 0, 0]])
    distance, _, cosine = scene.cast(origins, directions)
    np.testing.assert_allclose(distance, [1.5, 2.0 - 0.4, 2.0, np.inf], atol=1e-9)
    np.testing.assert_allclose(cosine[:3], [1.0, 0.8, 1.0], atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_equals_the_brute_force_twin(count: int) -> None:
    rng = np.random.default_rng(count)
    world = random_world(rng, count)
    n = 333
    origins = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(0.1, 3.5, n)])
    directions = unit(rng.standard_normal((n, 3)))
    distance, _, _ = build_scene(world).cast(origins, directions, reach=1e3)
    expected = np.array([slow_cast(world, o, d) for o, d in zip(origins, directions, strict=True)])
    expected[expected > 1e3] = np.inf
    np.testing.assert_allclose(distance, expected, atol=1e-6)


def test_axis_parallel_rays_and_empty_worlds() -> None:
    scene = build_scene(WorldSpec("empty", (), SE2()))
    distance, hit, _ = scene.cast(np.array([[0.0, 0, 1], [0, 0, 1]]), np.array([[0, 1.0, 0], [0, 0, -1.0]]))
    assert distance.tolist() == [np.inf, 1.0]
    assert hit.tolist() == [raycast.NOTHING, raycast.FLOOR]


def mujoco_cast(model: object, data: object, origin: F64, directions: F64) -> F64:
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "robot/base")
    n = len(directions)
    geoms, distance = np.zeros(n, np.int32), np.zeros(n)
    mujoco.mj_multiRay(model, data, origin, directions.ravel(), None, 1, base, geoms, distance, None, n, 1e3)
    return np.where(distance < 0, np.inf, distance)


# MuJoCo's rays do not pass glass, ours do: tests/sim/test_faults.py judges those.
@pytest.mark.parametrize("name", [name for name in world_names() if name != "glass"])
def test_agrees_with_mujoco_in_every_world(name: str) -> None:
    world = replace(load_world(name), ceiling=math.inf)
    model = mujoco.MjModel.from_xml_string(build_mjcf(world, [PlacedRobot("robot", robot_named("diff"), SE2())], 0.005))
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    mujoco.mj_forward(model, data)
    scene, rng = build_scene(world), np.random.default_rng(1)
    spec, free = reachable_cells(world, 0.3, 0.1, 1.0)
    places = spec.centers_of(rng.permutation(np.argwhere(free))[:12])
    places += rng.uniform(-0.04, 0.04, places.shape)  # or rays run along faces of solids
    directions = np.ascontiguousarray(VLP_16.directions()[::15].reshape(-1, 3))
    for x, y in places:
        ground = float(world.ground_at(np.array([[x, y]]))[0])
        origin = np.array([x, y, ground + rng.uniform(0.2, 1.0)])
        ours, _, _ = scene.cast(np.tile(origin, (len(directions), 1)), directions)
        theirs = mujoco_cast(model, data, origin, directions)
        agree = np.isclose(ours, theirs, atol=1e-3, rtol=0) | (np.isinf(ours) & np.isinf(theirs))
        edges = beside_an_edge(scene, origin, directions[~agree])
        assert edges.all(), f"{np.count_nonzero(~edges)} rays differ away from edges"
        assert np.count_nonzero(~agree) <= 0.003 * len(agree)


def beside_an_edge(scene: RayScene, origin: F64, directions: F64) -> NDArray[np.bool_]:
    """Tell for each ray whether turning it by a hair changes what it hits."""
    out = np.zeros(len(directions), bool)
    for k, d in enumerate(directions):
        near = unit(d + 1e-6 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]]))
        distance, _, _ = scene.cast(np.tile(origin, (6, 1)), near)
        out[k] = np.ptp(distance) > 1e-3
    return out


def test_a_moving_scanner_sees_from_where_it_is_when_each_beam_fires(wall_ahead: WorldSpec) -> None:
    sensor = LidarSensor(SCANNER_360.perfect(), "laser", build_scene(wall_ahead), 0)
    times = np.array([0.0, 0.03, 0.1])
    positions = np.column_stack([2.0 * times, 0 * times, 0 * times + 0.3])
    half = 0.5 * 1.5 * times
    quaternions = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    sensor.sweep(times, positions, quaternions)
    scan = sensor.to_scan(0)
    fired = np.arange(720) * scan.time_increment
    heading = scan.angle_min + np.arange(720) * scan.angle_increment + 1.5 * fired
    with np.errstate(divide="ignore"):
        expected = (3.0 - 2.0 * fired) / np.cos(heading)
    clear = (np.cos(heading) > 0.32) & (expected < 8.0)
    assert clear.sum() > 250
    np.testing.assert_allclose(scan.ranges[clear], expected[clear], atol=2e-4)
    assert np.isinf(scan.ranges[np.cos(heading) < -0.01]).all()


def test_a_sweep_compiles_nothing_after_the_warm_up() -> None:
    raycast.warm_up()
    for spec in (SCANNER_360, VLP_16):
        sensor = LidarSensor(spec, "laser", build_scene(load_world("lab_empty")), 0)
        sensor.sweep(np.array([0.0, 0.1]), np.array([[0.0, 0, 0.5]] * 2), np.array([[1.0, 0, 0, 0]] * 2))
        sensor.to_cloud(0)
    kernels = (raycast.cast_rays, raycast.sweep, raycast.corrupt_ranges, raycast.gather_points)
    assert [len(k.signatures) for k in kernels] == [1, 1, 1, 1]


def test_packets_do_not_depend_on_their_neighbours() -> None:
    """Any cut of the rays into calls gives the same bits."""
    world, rng = load_world("office"), np.random.default_rng(5)
    scene = build_scene(world)
    origins = np.tile([2.0, 0.0, 0.5], (100, 1))
    directions = unit(rng.standard_normal((100, 3)))
    whole, hits, _ = scene.cast(origins, directions)
    for k in (0, 17, 99):
        one, hit, _ = scene.cast(origins[k : k + 1], directions[k : k + 1])
        assert one[0] == whole[k]
        assert hit[0] == hits[k]
