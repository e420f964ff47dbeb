"""The voxel layer: what it marks, what takes marks away again, what stays, and the floor under mounts that are off. Kernels against slow twins."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_FREE, COST_LETHAL, GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.layer import Moment, whole
from ambler.costmap.voxel_layer import NO_GROUND, VoxelConfig, VoxelLayer, VoxelView, view_of_cloud, view_of_depth
from ambler.kernels import voxels as kernels
from ambler.robots.depth import optical
from ambler.sim.depth_camera import DepthCameraSensor
from ambler.sim.lidar import LidarSensor
from ambler.sim.meshes import TriangleMesh
from ambler.sim.rig_errors import with_depth_mounts_off
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.sensors import D430, VLP_16
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.studies.made_ground import LEVEL, ramp

SPEC = GridSpec(0.05, 160, 160, -4.0, -4.0)
TOP = 1.15
CAMERA = optical((0.25, 0.0, 1.12), 0.0, 20.0)
WALLS = tuple(Solid("wall", Shape.BOX, SE2(x, y, 0.0), *size, 0.0, 2.5) for x, y, size in (
    (6.0, 0.0, (0.1, 12.0)), (-6.0, 0.0, (0.1, 12.0)), (0.0, 6.0, (12.0, 0.1)), (0.0, -6.0, (12.0, 0.1))))  # fmt: skip


def box(x: float, y: float, size: tuple[float, float], z_min: float, z_max: float, yaw: float = 0.0) -> Solid:
    return Solid("box", Shape.BOX, SE2(x, y, yaw), *size, z_min, z_max)


class Rig:
    """A camera that takes picture after picture of a room for one layer."""

    def __init__(self, *solids: Solid, seed: int = 0, layer: VoxelLayer | None = None) -> None:
        world = WorldSpec("w", (*WALLS, *solids), SE2(), ceiling=2.5)
        self.sensor = DepthCameraSensor(D430, f"depth{seed}", build_scene(world), seed)
        self.layer = layer if layer is not None else VoxelLayer(VoxelConfig(), TOP)

    def look(self, times: int, pose: SE3 = CAMERA) -> None:
        for _ in range(times):
            depth = self.sensor.take(pose, 0).depth
            self.layer.add(view_of_depth(depth, D430.model, pose, 0.0, D430.range_min, D430.range_max))
            self.layer.update(SPEC, Moment())

    @property
    def drawn(self) -> np.ndarray:
        master = np.full(SPEC.shape, COST_FREE, np.uint8)
        self.layer.draw_into(master, SPEC, whole(SPEC))
        return master

    def marks(self, x0: float, x1: float, y0: float, y1: float) -> int:
        """Count lethal cells in a rectangle."""
        (a, b), (c, d) = SPEC.cell_of(x0, y0), SPEC.cell_of(x1, y1)
        return int((self.drawn[a:c, b:d] == COST_LETHAL).sum())


TABLE = box(2.0, 0.0, (0.8, 1.4), 0.70, 0.73)


@pytest.mark.parametrize(
    ("solid", "place"),
    [
        (TABLE, (1.5, 2.6, -0.8, 0.8)),
        (box(1.8, 0.3, (0.03, 1.0), 0.6, 1.2), (1.6, 2.0, -0.3, 0.9)),
        (box(1.5, 0.0, (0.06, 1.6), 0.8, 0.86), (1.4, 1.6, -0.9, 0.9)),
        (box(1.5, 0.2, (0.4, 0.5), 0.5, 0.66), (1.2, 1.8, -0.1, 0.5)),
        (box(1.3, 0.0, (0.1, 0.1), 0.0, 0.25), (1.2, 1.4, -0.1, 0.1)),
    ],
    ids=["table", "sign", "bar", "drawer", "low_box"],
)
def test_what_stands_or_hangs_below_the_robots_top_is_marked_in_half_a_second(solid: Solid, place: tuple) -> None:
    rig = Rig(solid)
    rig.look(5)
    seen = np.argwhere(rig.drawn == COST_LETHAL)
    assert rig.marks(*place) >= 2
    xy = SPEC.centers_of(seen)
    local = solid.world_from_solid.inverse().transform(xy)
    beside = np.maximum(np.abs(local) - 0.5 * np.array([solid.size_x, solid.size_y]), 0.0)
    assert np.hypot(*beside.T).max() < 0.2, "nothing else is marked"


def test_the_edge_of_a_table_is_closed_over_its_whole_width() -> None:
    rig = Rig(TABLE)
    rig.look(6, optical((0.85, 0.0, 1.12), 0.0, 20.0))
    (iy0, ix0), (iy1, ix1) = SPEC.cell_of(1.6, -0.65), SPEC.cell_of(1.75, 0.65)
    assert (rig.drawn[iy0:iy1, ix0:ix1] == COST_LETHAL).any(axis=1).mean() > 0.95


def test_what_hangs_higher_than_the_robot_is_not_marked() -> None:
    rig = Rig(box(1.8, 0.0, (0.1, 2.0), TOP + 0.2, 2.5), box(3.0, 1.0, (1.0, 1.0), TOP + 0.2, TOP + 0.25))
    rig.look(8)
    assert rig.marks(0.0, 3.9, -3.0, 3.0) == 0


def test_one_hit_alone_marks_nothing() -> None:
    rig = Rig(TABLE)
    rig.look(1)
    assert not (rig.drawn == COST_LETHAL).any()


def test_what_has_gone_vanishes_within_a_second_and_what_is_out_of_view_stays() -> None:
    behind = box(-2.0, 0.0, (0.5, 0.5), 0.5, 1.0)
    rig = Rig(TABLE, behind)
    rig.look(15, optical((-0.25, 0.0, 1.12), 180.0, 20.0))
    rig.look(15)
    kept = rig.marks(-2.6, -1.4, -0.6, 0.6)
    assert kept >= 4
    assert rig.marks(1.4, 2.6, -0.8, 0.8) >= 20
    empty = Rig(layer=rig.layer, seed=1)
    empty.look(10)  # one second
    assert empty.marks(1.4, 2.6, -0.8, 0.8) == 0
    assert empty.marks(-2.6, -1.4, -0.6, 0.6) == kept


def test_what_is_hidden_behind_something_nearer_stays() -> None:
    far = box(2.8, 0.0, (0.2, 0.6), 0.4, 1.0)
    rig = Rig(far)
    rig.look(10)
    kept = rig.marks(2.6, 3.0, -0.4, 0.4)
    assert kept >= 4
    hiding = Rig(box(1.2, 0.0, (0.1, 3.0), 0.0, 2.0), layer=rig.layer, seed=2)
    hiding.look(20)
    assert hiding.marks(2.6, 3.0, -0.4, 0.4) == kept


def test_a_table_seen_at_a_flat_angle_is_not_worn_away() -> None:
    low = optical((0.25, 0.0, 0.85), 0.0, 5.0)
    rig = Rig(box(2.5, 0.0, (1.5, 1.4), 0.70, 0.73))
    counts = []
    for _ in range(30):
        rig.look(1, low)
        counts.append(rig.marks(1.7, 2.4, -0.6, 0.6))
    assert min(counts[10:]) > 0.7 * max(counts)


@pytest.mark.parametrize("seed", range(12))
def test_the_floor_is_no_obstacle_with_mounts_off_by_5_cm_and_3_degrees(seed: int) -> None:
    robot = robot_named("spot+depth" if seed % 2 else "porter+depth")
    built = with_depth_mounts_off(robot, seed, 0.05, math.radians(3.0))
    rng = np.random.default_rng(seed)
    world = build_scene(WorldSpec("w", WALLS, SE2()))
    layer = VoxelLayer(VoxelConfig(), robot.model.top)
    pairs = list(zip(robot.model.depth_cameras, built.model.depth_cameras, strict=True))
    for drawn, true in pairs:
        sensor = DepthCameraSensor(D430, drawn.frame, world, seed)
        corner = true.base_from_sensor
        extreme = SE3.from_rpy((0.0, 0.0, 0.0), *(math.radians(3.0) * float(s) for s in rng.choice([-1, 1], 2)), 0.0)
        place = corner.translation
        worst = SE3(place, (extreme @ SE3((0.0, 0.0, 0.0), drawn.base_from_sensor.rotation)).rotation)
        for pose in (corner, worst):
            for _ in range(15):
                view = view_of_depth(sensor.take(pose, 0).depth, D430.model, drawn.base_from_sensor, 0.0, 0.3, 4.0)
                layer.add(view)
                layer.update(SPEC, Moment())
    marked = layer.marked()
    near = marked[np.abs(marked[:, :2]).max(axis=1) < 3.9]
    assert len(near) == 0
    assert len(layer.marked()) == len(marked)


def test_a_clouds_marks_go_when_it_sees_through_them() -> None:
    config = VoxelConfig()
    layer = VoxelLayer(config, TOP)
    mount = SE3((0.0, 0.0, 0.78))

    def look(times: int, *solids: Solid) -> int:
        scene = build_scene(WorldSpec("w", (*WALLS, *solids), SE2(), ceiling=2.5))
        lidar = LidarSensor(VLP_16, "velodyne", scene, 3)
        at, q = np.array([mount.translation] * 2), np.array([mount.rotation] * 2)
        for _ in range(times):
            lidar.sweep(np.array([0.0, 0.1]), at, q)
            cloud = lidar.to_cloud(0)
            poses = mount.matrix()[None, :3].copy()
            layer.add(view_of_cloud(cloud.points, cloud.time, poses, 1.0, 0.0, 0.4, (-0.27, 0.27), config))
            layer.update(SPEC, Moment())
        marked = layer.marked()
        return int((np.abs(marked[:, :2] - (2.0, 0.5)).max(axis=1) < 0.5).sum()) if len(marked) else 0

    thing = box(2.0, 0.5, (0.4, 0.4), 0.5, 1.1)
    assert look(4, thing) > 20
    assert look(10) == 0


def test_the_sweep_of_a_cloud_is_placed_where_the_robot_was() -> None:
    hits = np.zeros(SPEC.shape, np.uint32)
    points, times = np.full((2, 3), (1.0, 0.0, 0.5), np.float32), np.array([0.0, 0.1], np.float32)
    poses = np.stack([SE3((0.05 * k, 0.0, 0.0)).matrix()[:3] for k in range(6)])
    place = kernels.VoxelPlace(np.array([-4.0, -4.0, 0.05]), 0.05, -0.1)
    kernels.mark_hits(points, times, poses, 0.02, 0.3, 4.0, place, kernels.Band(0.0, NO_GROUND, 0.07, 0.05, 1.2), hits)
    assert set(zip(*(a.tolist() for a in np.nonzero(hits)), strict=True)) == {
        SPEC.cell_of(1.001, 0.001),
        SPEC.cell_of(1.251, 0.001),
    }


def test_the_footprint_is_emptied_and_clear_forgets() -> None:
    rig = Rig(TABLE)
    rig.look(6)
    around = np.array([[1.0, -1.0], [3.0, -1.0], [3.0, 1.0], [1.0, 1.0]])
    box_told = rig.layer.update(SPEC, Moment(footprint=around))
    assert box_told is not None
    assert rig.marks(1.05, 2.95, -0.95, 0.95) == 0
    rig.look(6)
    assert rig.marks(1.5, 2.6, -0.8, 0.8) > 0
    rig.layer.clear()
    assert not (rig.drawn == COST_LETHAL).any()
    assert len(rig.layer.marked()) == 0


def test_marks_keep_their_height_when_the_floor_rises() -> None:
    layer = VoxelLayer(VoxelConfig(), TOP)

    def view(floor: float) -> VoxelView:
        points = np.array([[1.01, 0.01, 0.51]], np.float32)
        picture = np.zeros((4, 4), np.float32)
        return VoxelView(
            *(points, np.zeros(1, np.float32), np.eye(4)[None, :3].copy(), 1.0, floor, 0.3, 4.0),
            *(picture, False, np.ones(4)),
        )

    for floor in (0.0, 0.0, 0.0, 0.22):
        layer.add(view(floor))
        layer.update(SPEC, Moment())
    np.testing.assert_allclose(layer.marked(), [[1.025, 0.025, 0.525]], atol=1e-5)
    for floor in (-0.3, 0.22):
        layer.add(view(floor))
        layer.update(SPEC, Moment())
    np.testing.assert_allclose(layer.marked(), [[1.025, 0.025, 0.525]], atol=1e-5)
    layer.add(view(0.8))
    layer.update(SPEC, Moment())
    assert len(layer.marked()) == 0, "what lies well below the floor is no obstacle"


def test_a_slope_whose_ground_is_known_is_no_obstacle_and_what_stands_on_it_is() -> None:
    mesh, _ = ramp(1.2, 4.0, math.radians(15.0))
    mesh = TriangleMesh("ramp", mesh.vertices - (0.0, 0.0, LEVEL), mesh.triangles)
    thing = box(2.5, 0.5, (0.3, 0.3), 0.0, 1.3 * math.tan(math.radians(15.0)) + 0.5)
    scene = build_scene(WorldSpec("w", (*WALLS, thing), SE2(), meshes=(mesh,), ceiling=2.5))
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-4.0, 5.0, 0.2), np.arange(-3.9, 4.0, 0.2)))
    told = np.maximum(0.0, (x - 1.2) * math.tan(math.radians(15.0)))
    counts = []
    for has_ground in (False, True):
        layer, sensor = VoxelLayer(VoxelConfig(), TOP), DepthCameraSensor(D430, "depth", scene, 1)
        if has_ground:
            layer.set_ground(np.stack([x, y], axis=1), told)
        for _ in range(6):
            layer.add(view_of_depth(sensor.take(CAMERA, 0).depth, D430.model, CAMERA, 0.0, 0.3, 4.0))
            layer.update(SPEC, Moment())
        xy = layer.marked()[:, :2]
        on_thing = np.abs(xy - (2.5, 0.5)).max(axis=1) < 0.25
        counts.append((int(on_thing.sum()), int((~on_thing).sum())))
    (_, slope_without), (thing_with, slope_with) = counts
    assert slope_without > 50
    assert slope_with == 0
    assert thing_with > 5
    with pytest.raises(BadInputError, match="ground"):
        layer.set_ground(np.zeros((2, 2)), np.zeros(3))


def slow_hits(points: np.ndarray, pose: SE3, floor: float, c: VoxelConfig, bottom: float) -> set:
    out = set()
    for p in points.astype(np.float64):
        r, q = math.sqrt(p @ p), pose.transform(p[None])[0]
        over = q[2] - floor
        if 0.3 <= r <= 4.0 and c.doubt + c.lean * r <= over <= TOP:
            iy, ix = SPEC.cell_of(float(q[0]), float(q[1]))
            iz = math.floor((q[2] - bottom) / c.level)
            if 0 <= iy < SPEC.height and 0 <= ix < SPEC.width and 0 <= iz < kernels.LEVELS:
                out.add((iy, ix, iz))
    return out


@pytest.mark.parametrize("seed", range(4))
def test_hits_are_those_of_the_slow_twin(seed: int) -> None:
    rng, c = np.random.default_rng(seed), VoxelConfig()
    points = rng.uniform(-3.0, 3.0, (500, 3)).astype(np.float32)
    pose = SE3.from_rpy(tuple(rng.uniform(-1.0, 1.0, 3)), *rng.uniform(-1.0, 1.0, 3))
    hits = np.zeros(SPEC.shape, np.uint32)
    place, bottom = np.array([-4.0, -4.0, 0.05]), -0.1
    times, poses = np.zeros(500, np.float32), pose.matrix()[None, :3].copy()
    band = kernels.Band(0.05, NO_GROUND, c.doubt, c.lean, TOP)
    there = kernels.VoxelPlace(place, c.level, bottom)
    kernels.mark_hits(points, times, poses, 1.0, 0.3, 4.0, there, band, hits)
    bits = (hits[..., None] >> np.arange(32, dtype=np.uint32)) & 1
    assert set(map(tuple, np.argwhere(bits).tolist())) == slow_hits(points, pose, 0.05, c, bottom)


def slow_is_through(picture: np.ndarray, p: np.ndarray, lens: np.ndarray, margin: float, spread: float) -> bool:
    if p[2] <= 0.0:
        return False
    u, v = lens[2] + lens[0] * p[0] / p[2], lens[3] + lens[1] * p[1] / p[2]
    around = list(itertools.product((math.floor(v), math.floor(v) + 1), (math.floor(u), math.floor(u) + 1)))
    if not all(0 <= a < picture.shape[0] and 0 <= b < picture.shape[1] for a, b in around):
        return False
    seen = [picture[a, b] for a, b in around if picture[a, b] > 0]
    return len(seen) >= 2 and min(seen) >= p[2] + margin + spread * p[2] ** 2


@pytest.mark.parametrize("seed", range(4))
def test_evidence_is_that_of_the_slow_twin(seed: int) -> None:
    rng, c = np.random.default_rng(seed), VoxelConfig()
    spec, bottom = GridSpec(0.1, 20, 20, 0.5, -1.0), -0.1
    place = np.array([0.5, -1.0, 0.1])
    scores = rng.integers(0, 7, (20, 20, kernels.LEVELS)).astype(np.int8)
    bits = np.uint32(1) << np.arange(32, dtype=np.uint32)
    occupied = ((scores > 0) * bits).sum(axis=2, dtype=np.uint32)
    hits = rng.integers(0, 2**32, (20, 20), dtype=np.uint32) & rng.integers(0, 2**32, (20, 20), dtype=np.uint32)
    is_hit = ((hits[..., None] >> np.arange(32, dtype=np.uint32)) & 1).astype(bool)
    picture = rng.choice(np.array([0.0, 0.8, 1.5, 3.0, 9.0], np.float32), (30, 40))
    lens = np.array([25.0, 25.0, 19.5, 14.5])
    pose = optical((0.1, 0.05, 0.9), 5.0, 15.0)
    expected = scores.copy()
    for iy, ix, iz in itertools.product(range(20), range(20), range(32)):
        if is_hit[iy, ix, iz]:
            expected[iy, ix, iz] = min(scores[iy, ix, iz] + c.gain, c.most)
            continue
        x, y = spec.center_of(iy, ix)
        p = pose.inverse().transform(np.array([[x, y, bottom + (iz + 0.5) * 0.05]]))[0]
        is_near = 0.3 <= math.sqrt(p @ p) <= 4.0
        if scores[iy, ix, iz] > 0 and is_near and slow_is_through(picture, p, lens, c.margin, c.spread):
            expected[iy, ix, iz] -= 1
    marked, matrix = np.zeros((20, 20), np.uint32), pose.matrix()[:3].copy()
    kernels.weigh(
        *(kernels.Voxels(scores, occupied, marked), hits, (0, 20, 0, 20)),
        *(kernels.Picture(picture, False, lens, 0.3, 4.0), matrix, kernels.VoxelPlace(place, 0.05, bottom)),
        kernels.Weights(c.margin, c.spread, c.gain, c.most, c.enough),
    )
    np.testing.assert_array_equal(scores, expected)
    np.testing.assert_array_equal(occupied, ((expected > 0) * bits).sum(axis=2, dtype=np.uint32))
    np.testing.assert_array_equal(marked, ((expected >= c.enough) * bits).sum(axis=2, dtype=np.uint32))
    assert not hits.any()


def test_the_picture_of_a_cloud_holds_the_nearest_range_of_each_direction() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-5.0, 5.0, (4000, 3)).astype(np.float32)
    step, lowest = 0.1, -0.6
    picture = np.empty((12, 63), np.float32)
    kernels.view_of_cloud(points, step, lowest, picture)
    p = points.astype(np.float64)
    v = np.floor((np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1])) - lowest) / step).astype(int)
    u = np.floor((np.arctan2(p[:, 1], p[:, 0]) + math.pi) / step).astype(int) % 63
    expected = np.full(picture.shape, np.inf)
    inside = (v >= 0) & (v < 12)
    np.minimum.at(expected, (v[inside], u[inside]), np.linalg.norm(p[inside], axis=1))
    np.testing.assert_allclose(picture, np.where(np.isinf(expected), 0.0, expected), rtol=1e-5)
