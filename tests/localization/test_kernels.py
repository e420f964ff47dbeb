"""Kernels of localization against slow NumPy twins and numerical derivatives."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.kernels import branch_bound, grid_tracker, likelihood_field, particles, relocalization
from ambler.localization.surface_map import REACH, SurfaceMap
from tests.localization import rooms


@pytest.fixture(scope="module")
def office_map() -> SurfaceMap:
    return SurfaceMap.from_occupancy(*rooms.office().occupancy())


def distances_to_segments(room: rooms.Room, points: np.ndarray) -> np.ndarray:
    seg = room.segments
    edge = seg[:, 2:] - seg[:, :2]
    u = ((points[:, None] - seg[None, :, :2]) * edge).sum(-1) / np.square(edge).sum(-1)
    near = seg[None, :, :2] + np.clip(u, 0, 1)[..., None] * edge
    return np.asarray(np.hypot(*(points[:, None] - near).transpose(2, 0, 1)).min(axis=1))


@pytest.mark.parametrize("is_filled", [True, False])
def test_surfaces_lie_on_the_walls_whatever_is_behind_them(is_filled: bool) -> None:
    room = rooms.office()
    surfaces = SurfaceMap.from_occupancy(*room.occupancy(is_filled=is_filled)).surfaces
    away = distances_to_segments(room, surfaces[:, :2])
    assert np.median(away) < 1e-9  # walls along the grid: exact
    assert np.percentile(away, 99) < 0.015  # turned walls: smoothed stairs
    np.testing.assert_allclose(np.hypot(surfaces[:, 2], surfaces[:, 3]), 1.0, atol=1e-9)


def test_a_turned_wall_becomes_straight() -> None:
    room = rooms.Room("turned", (8.0, 8.0), (rooms.box(4.0, 4.0, 5.0, 1.0, 0.46),))
    surfaces = SurfaceMap.from_occupancy(*room.occupancy()).surfaces
    there = (np.abs(surfaces[:, :2] - 4.0) < 2.7).all(axis=1)
    inside = SE2(4.0, 4.0, 0.46).inverse().transform(surfaces[there, :2])
    long_side = np.abs(inside[:, 0]) < 2.1
    assert np.abs(np.abs(inside[long_side, 1]) - 0.5).mean() < 0.008
    across = np.abs(surfaces[there][long_side] @ np.array([0, 0, -math.sin(0.46), math.cos(0.46)]))
    assert np.degrees(np.arccos(np.clip(across, 0, 1))).mean() < 3.0


def test_grey_values_place_the_surface_within_the_cell() -> None:
    cells = np.zeros((9, 40), np.int8)
    cells[:, 20] = 80
    surfaces = SurfaceMap.from_occupancy(cells, GridSpec(0.05, 40, 9, 0.0, 0.0)).surfaces
    left = surfaces[surfaces[:, 2] < 0]
    np.testing.assert_allclose(left[:, 0], 0.05 * (20.5 - 30 / 80), atol=1e-9)


def test_a_map_without_walls_is_refused() -> None:
    with pytest.raises(BadInputError, match="nothing to localize"):
        SurfaceMap.from_occupancy(np.zeros((4, 4), np.int8), GridSpec(0.05, 4, 4, 0.0, 0.0))
    with pytest.raises(BadInputError, match="description"):
        SurfaceMap.from_occupancy(np.zeros((4, 4), np.int8), GridSpec(0.05, 5, 4, 0.0, 0.0))


def test_nearest_surfaces_are_nearest(office_map: SurfaceMap) -> None:
    rng = np.random.default_rng(0)
    spec = office_map.spec
    points = rng.uniform((-0.4, -0.4), (14.3, 9.3), (400, 2))
    cells = spec.cells_of(points)
    centers = spec.centers_of(cells)
    true = np.hypot(*(centers[:, None] - office_map.surfaces[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
    told = office_map.distance[cells[:, 0], cells[:, 1]]
    np.testing.assert_allclose(told, np.minimum(true, REACH), atol=1e-5)


def test_beams_never_pair_with_the_far_side_of_a_wall(office_map: SurfaceMap) -> None:
    # The wall at x = 4.9 ... 5.1 seen from the left, points up to 8 cm behind its face.
    for depth in (-0.08, -0.02, 0.0, 0.03, 0.08):
        k = grid_tracker.find_surface(
            office_map.nearest, office_map.surfaces, office_map.frame, 4.9 + depth, 2.0, 1.0, 0.1
        )
        assert office_map.surfaces[k, 0] == pytest.approx(4.9)
        assert office_map.surfaces[k, 2] == pytest.approx(-1.0)


def test_gradient_of_the_match_is_that_of_its_cost(office_map: SurfaceMap) -> None:
    """Geman-McClure: cost q / (1 + q), q = r² / scale², so d cost / d state = 2 g / scale²."""
    truth = SE2(7.0, 4.0, 0.3)
    rng = np.random.default_rng(2)
    points = rooms.office().scan(truth, rng, beams=200)
    state = np.array([7.01, 3.99, 0.305, 0.004])
    h, g, info = np.zeros((4, 4)), np.zeros(4), np.zeros(4)

    def cost(s: np.ndarray) -> float:
        a, b = np.zeros((4, 4)), np.zeros(4)
        grid_tracker.accumulate(
            office_map.nearest, office_map.surfaces, office_map.frame, points, s, 0.1, 10.0, a, b, info
        )
        return float(info[0]) * len(points)

    grid_tracker.accumulate(
        office_map.nearest, office_map.surfaces, office_map.frame, points, state, 0.1, 10.0, h, g, info
    )
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-7
        slope = (cost(state + step) - cost(state - step)) / 2e-7
        assert slope == pytest.approx(2.0 * g[k] / 0.01, rel=0.02, abs=2.0)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_eigen3_diagonalizes(seed: int) -> None:
    a = np.random.default_rng(seed).normal(size=(3, 3))
    m = a @ a.T
    values, vectors = np.empty(3), np.empty((3, 3))
    grid_tracker.eigen3(m.copy(), values, vectors)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(m), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(vectors @ np.diag(values) @ vectors.T, m, atol=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_projection_removes_only_the_undetermined(seed: int) -> None:
    """Normals that all point along y leave x without information and change nothing else."""
    rng = np.random.default_rng(seed)
    j = np.column_stack([np.zeros(50), np.ones(50), rng.uniform(-5, 5, 50), np.ones(50)])
    j[::2] *= -1.0
    j[:, 3] = 1.0
    h, g = j.T @ j, j.T @ rng.normal(size=50)
    expected, gradient = h.copy(), g.copy()
    kept = grid_tracker.project(h, g, 3.0, 0.01, 3.0, np.empty((3, 3)), np.empty(3), np.empty((3, 3)))
    assert kept == 2
    np.testing.assert_allclose(h, expected, atol=1e-6)
    np.testing.assert_allclose(g, gradient, atol=1e-6)


def test_an_undetermined_direction_tells_nothing_of_the_depth() -> None:
    """A long wall along x and two points on its end: while x is unknown they must not tell where surfaces really lie."""
    rng = np.random.default_rng(2)
    wall = np.column_stack([np.zeros(50), np.ones(50), rng.uniform(-5, 5, 50), np.ones(50)])
    end = np.array([[1.0, 0.0, 0.3, 1.0], [1.0, 0.0, -0.2, 1.0]])
    h, g = np.zeros((4, 4)), np.zeros(4)
    for j, r in ((wall, np.full(50, 0.01)), (end, np.full(2, 0.3))):
        h += j.T @ j
        g += j.T @ r
    kept = grid_tracker.project(h, g, 3.0, 0.01, 3.0, np.empty((3, 3)), np.empty(3), np.empty((3, 3)))
    assert kept == 2
    depth = h[3, 3] - h[3, 1:3] @ np.linalg.solve(h[1:3, 1:3], h[1:3, 3])
    assert abs(depth) < 0.01
    assert g[3] - h[3, 1:3] @ np.linalg.solve(h[1:3, 1:3], g[1:3]) == pytest.approx(0.0, abs=0.01)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_solve4_solves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(4, 4))
    m, b, x = a @ a.T + 0.1 * np.eye(4), rng.normal(size=4), np.empty(4)
    assert grid_tracker.solve4(m.copy(), b, x)
    np.testing.assert_allclose(m @ x, b, atol=1e-8)
    assert not grid_tracker.solve4(-m, b, x)


def test_systematic_resampling_is_fair() -> None:
    rng = np.random.default_rng(1)
    weights = rng.random(50)
    weights /= weights.sum()
    counts = np.zeros(50)
    for _ in range(400):
        chosen = np.empty(100, np.int64)
        particles.resample_systematic(weights, rng.random(), chosen)
        each = np.bincount(chosen, minlength=50)
        assert (np.abs(each - 100 * weights) < 1.0 + 1e-9).all()  # never more than one off
        counts += each
    np.testing.assert_allclose(counts / counts.sum(), weights, atol=0.002)


@pytest.mark.parametrize("model", [particles.move_differential, particles.move_omni])
def test_motion_models_are_unbiased_and_spread_as_told(model: object) -> None:
    rng = np.random.default_rng(4)
    cloud = np.tile([1.0, 2.0, 0.7], (20_000, 1))
    motion = np.array([0.3, 0.05 if model is particles.move_omni else 0.0, 0.1])
    model(cloud, motion, np.array([0.02, 0.01, 0.03, 0.01, 0.02]), rng.standard_normal(cloud.shape))  # type: ignore[operator]
    moved = SE2(1.0, 2.0, 0.7) @ SE2.from_array(motion)
    np.testing.assert_allclose(cloud.mean(axis=0), moved.as_array(), atol=2e-3)
    way2, turn2 = float(motion[0] ** 2 + motion[1] ** 2), 0.01
    local = (cloud[:, :2] - moved.as_array()[:2]) @ np.array(
        [math.cos(0.7 + math.atan2(motion[1], motion[0])), math.sin(0.7 + math.atan2(motion[1], motion[0]))]
    )
    expected = 0.03 * way2 + 0.01 * turn2
    assert local.var() == pytest.approx(expected, rel=0.15)


def test_standing_still_spreads_nothing() -> None:
    cloud = np.tile([1.0, 2.0, 0.7], (10, 1))
    for model in (particles.move_differential, particles.move_omni):
        model(cloud, np.zeros(3), np.full(5, 0.2), np.random.default_rng(0).standard_normal(cloud.shape))
        np.testing.assert_allclose(cloud, np.tile([1.0, 2.0, 0.7], (10, 1)), atol=1e-12)


def test_bins_and_clusters_equal_their_twins() -> None:
    rng = np.random.default_rng(6)
    a = rng.normal((2.0, 3.0, 3.1), (0.4, 0.4, 0.2), (300, 3))  # across the seam of yaw
    b = rng.normal((9.0, 3.0, 0.0), (0.2, 0.2, 0.1), (150, 3))
    cloud = np.vstack([a, b])
    cloud[:, 2] = np.arctan2(np.sin(cloud[:, 2]), np.cos(cloud[:, 2]))
    weights = np.full(450, 1 / 450)
    keys, table, bins = np.empty((450, 3), np.int64), np.empty(1024, np.int64), np.empty(450, np.int64)
    size = np.array([0.5, math.pi / 18])
    count = particles.assign_bins(cloud, size, keys, table, bins)
    twin = np.floor(cloud / [0.5, 0.5, math.pi / 18]).astype(int)
    assert count == len(np.unique(twin, axis=0))
    np.testing.assert_array_equal(keys[bins], twin)
    label = np.empty(450, np.int64)
    best, weight = particles.heaviest_cluster(
        weights, keys, table, bins, count, 36, label, np.empty(450, np.int64), np.empty(450)
    )
    members = label[bins] == best
    assert members[:300].mean() > 0.97
    assert not members[300:].any()
    assert weight == pytest.approx(members.mean())
    mean, covariance = np.empty(3), np.empty((3, 3))
    particles.moments(cloud, weights, bins, label, best, mean, covariance)
    np.testing.assert_allclose(mean[:2], cloud[members, :2].mean(axis=0), atol=1e-9)
    assert abs(math.remainder(mean[2] - 3.1, 2 * math.pi)) < 0.05
    np.testing.assert_allclose(covariance[:2, :2], np.cov(cloud[members, :2].T, bias=True), atol=1e-9)


def test_field_weights_equal_their_twin(office_map: SurfaceMap) -> None:
    rng = np.random.default_rng(3)
    truth = SE2(7.0, 4.0, 0.3)
    points = rooms.office().scan(truth, rng, beams=60)
    cloud = truth.as_array() + rng.normal(size=(20, 3)) * [0.3, 0.3, 0.2]
    field = np.empty(office_map.spec.shape, np.float32)
    likelihood_field.log_likelihood_field(office_map.distance, 0.1, 0.9, 0.1, field)
    out = np.empty(20)
    likelihood_field.weigh_by_field(field, office_map.frame, cloud, points, -2.0, 0.5, out)
    for i in range(20):
        ends = SE2.from_array(cloud[i]).transform(points)
        total = 0.0
        for iy, ix in office_map.spec.cells_of(ends):
            inside = office_map.spec.contains_cell(iy, ix)
            d = float(office_map.distance[iy, ix]) if inside else 0.0
            total += math.log(0.9 * math.exp(-d * d / 0.02) + 0.1) if inside else -2.0
        assert out[i] == pytest.approx(0.5 * total, rel=1e-4)


def test_rays_on_the_grid_meet_the_true_walls(office_map: SurfaceMap) -> None:
    """Walls along the grid are exact; turned boxes are stairs of 5 cm."""
    room, pose = rooms.office(), SE2(7.03, 4.02, 0.0)
    angles = np.linspace(-math.pi, math.pi, 240, endpoint=False)
    true = room.cast(pose, angles)
    told = [
        likelihood_field.cast_ray(office_map.cells, office_map.frame, pose.x, pose.y, math.cos(a), math.sin(a), 30.0)
        for a in angles
    ]
    errors = np.abs(np.array(told) - true)
    assert np.median(errors) < 1e-6
    assert np.percentile(errors, 95) < 0.1


def test_contradictions_tell_people_from_a_wrong_pose(office_map: SurfaceMap) -> None:
    truth = SE2(7.0, 4.0, 0.3)
    points = rooms.office().scan(truth, np.random.default_rng(0), beams=240)
    counts = np.empty(3, np.int64)
    likelihood_field.contradictions(office_map.cells, office_map.frame, points, truth.as_array(), 0.15, counts)
    assert counts[0] > 0.97 * len(points)
    nearer = (points * 0.5).astype(np.float32)
    likelihood_field.contradictions(office_map.cells, office_map.frame, nearer, truth.as_array(), 0.15, counts)
    assert counts[2] > 0.9 * len(points)
    wrong = np.array([2.0, 3.0, 1.0])
    likelihood_field.contradictions(office_map.cells, office_map.frame, points, wrong, 0.15, counts)
    assert counts[1] > 0.2 * len(points)


def test_search_finds_the_best_of_all_poses() -> None:
    """Branch and bound against the exhaustive sum, on a small random field."""
    rng = np.random.default_rng(5)
    distance = (rng.random((24, 24)) * 0.6).astype(np.float32)
    cells = np.empty((24, 24), np.uint16)
    relocalization.score_cells(distance, 0.12, 1, cells)
    free = rng.random((24, 24)) < 0.7
    depth, pad = 4, 7
    stack = np.empty((depth, 24 + pad, 24 + pad), np.uint8)
    branch_bound.build_stack(cells, stack)
    points = rng.uniform(-0.5, 0.5, (12, 2)).astype(np.float32)
    angles = np.arange(16) * (math.pi / 8) - math.pi
    best = np.empty((9 * 4, 4), np.int64)
    relocalization.search(stack, free, 0.1, points, angles, 4, 0.5, 0, best)
    twin = -1
    level = np.pad(stack[0][pad:, pad:].astype(int), 10)
    for a, iy, ix in itertools.product(range(16), range(24), range(24)):
        if free[iy, ix]:
            c, s = math.cos(angles[a]), math.sin(angles[a])
            jx = np.floor((c * points[:, 0] - s * points[:, 1]) / 0.1 + 0.5).astype(int) + ix + 10
            jy = np.floor((s * points[:, 0] + c * points[:, 1]) / 0.1 + 0.5).astype(int) + iy + 10
            twin = max(twin, int(level[jy, jx].sum()))
    assert best[:, 0].max() == twin


def test_nothing_compiles_after_warm_up() -> None:
    """A fresh process warms up, then localizes in every way; no kernel may get a new signature while the robot moves."""
    script = """
import importlib, numpy as np
from ambler.kernels.warmup import compiled_signatures
names = ["branch_bound", "grid_tracker", "likelihood_field", "particles", "planar_ekf", "relocalization", "surfaces"]
for name in names:
    importlib.import_module(f"ambler.kernels.{name}").warm_up()
def counts():
    found = {}
    for name in names:
        for key, value in vars(importlib.import_module(f"ambler.kernels.{name}")).items():
            if hasattr(value, "signatures"):
                found[f"{name}.{key}"] = len(value.signatures)
    return found
before = counts()
from ambler.core.se2 import SE2
from ambler.localization.localizer import Observation
from ambler.localization.planar_ekf import EkfConfig, PlanarEkf
from ambler.localization.relocalizer import Relocalizer, RelocalizerConfig
from ambler.localization.supervisor import Supervisor, SupervisorConfig
from tests.localization import rooms
from tests.localization.test_localizers import MAKERS
from ambler.localization.surface_map import SurfaceMap
room = rooms.office()
surfaces = SurfaceMap.from_occupancy(*room.occupancy())
rng = np.random.default_rng(0)
pose = SE2(7.0, 4.0, 0.3)
points = room.scan(pose, rng, beams=240)
points.flags.writeable = False
for maker in MAKERS.values():
    localizer = maker(surfaces, room)
    localizer.set_pose(0, SE2(), SE2(7.1, 4.0, 0.3))
    supervisor = Supervisor(surfaces, localizer, Relocalizer(surfaces, RelocalizerConfig()), SupervisorConfig())
    for k in range(3):
        supervisor.update(Observation(k, SE2(0.2 * k, 0, 0), points, room.intensities(pose, points)))
    supervisor.distrust("test")
    supervisor.update(Observation(9, SE2(), points))
ekf = PlanarEkf(EkfConfig())
ekf.add_twist(0, np.zeros(3), np.eye(3))
ekf.add_imu(1, 0.0, 1e-4, np.zeros(2))
ekf.add_pose(2, SE2(), np.eye(3))
ekf.estimate(10_000)
after = counts()
assert after == before, {k: (before[k], after[k]) for k in before if before[k] != after[k]}
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-800:]
