"""What every layer must do. A new layer joins by one line in LAYERS: how it is made, and how chance feeds it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from examples.keep_out_zones import KeepOutLayer
from scipy.ndimage import label

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import Polygon
from ambler.core.se2 import SE2
from ambler.costmap.blocked_layer import AddedLayer, BlockedLayer, BoundaryLayer, PlacesLayer
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.layer import Layer, Moment, box_around, cells_within, clear_layers, union, whole
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeConfig, RangeLayer
from ambler.costmap.static_layer import StaticConfig, StaticLayer
from ambler.costmap.voxel_layer import VoxelConfig, VoxelLayer, view_of_depth
from ambler.robots.depth import optical

SPEC = GridSpec(0.1, 40, 30, -2.0, -1.5)
GROWN = GridSpec(0.1, 50, 44, -2.5, -2.0)
FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
Feed = Callable[[Layer, np.random.Generator, GridSpec], None]


def feed_map(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, StaticLayer)
    cells = np.zeros(spec.shape, np.int8)
    y, x = int(rng.integers(0, 25)), int(rng.integers(0, 35))
    cells[y : y + 5, x : x + 5] = 100
    layer.set_map(spec, cells)


def feed_rays(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, ObstacleLayer)
    x, y = rng.uniform(-1.5, 1.5, 2)
    layer.add([SensorRays((float(x), float(y)), rng.uniform(-4, 4, (20, 2)), rng.uniform(-4, 4, (20, 2)))])


def feed_cones(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, RangeLayer)
    (x, y), yaw = rng.uniform(-1.5, 1.5, 2), float(rng.uniform(-3, 3))
    echo = float(rng.choice([0.5, 1.0, math.inf]))
    layer.add([RangeCone(float(x), float(y), yaw, 0.3, min(echo, 1.5), echo)] * 3, float(rng.uniform(0, 3)))


def feed_glass(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, GlassLayer)
    layer.set_segments(rng.uniform(-3, 3, (int(rng.integers(0, 4)), 4)))


def feed_blocked(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, PlacesLayer)
    layer.set_points(rng.uniform(-3, 3, (int(rng.integers(0, 6)), 2)))


def feed_views(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, VoxelLayer)
    pose = optical((*(float(v) for v in rng.uniform(-1.0, 1.0, 2)), 0.6), float(rng.uniform(-180, 180)), 10.0)
    depth = rng.choice(np.array([0, 700, 1200, 3000], np.uint16), (4, 5)).repeat(4, axis=0).repeat(4, axis=1)
    model = CameraModel("depth", 20, 16, 12.0, 12.0, 9.5, 7.5)
    layer.add(view_of_depth(depth, model, pose, 0.0, 0.3, 4.0))
    layer.add(view_of_depth(depth, model, pose, 0.0, 0.3, 4.0))


def feed_boundary(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, BoundaryLayer)
    layer.set_corners(rng.uniform(-2.5, 2.5, (int(rng.choice([0, 3, 5])), 2)))


def feed_zones(layer: Layer, rng: np.random.Generator, spec: GridSpec) -> None:
    assert isinstance(layer, KeepOutLayer)
    zone = np.zeros((int(rng.choice([0, 3, 5])), 3), np.float32)
    zone[:, :2] = rng.uniform(-3, 3, (len(zone), 2))
    layer.take(Polygon(0, "map", zone), None)  # type: ignore[arg-type]


LAYERS: dict[str, tuple[Callable[[], Layer], Feed]] = {
    "static": (lambda: StaticLayer(StaticConfig()), feed_map),
    "obstacles": (lambda: ObstacleLayer(ObstacleConfig(1.0, 1.5)), feed_rays),
    "cones": (lambda: RangeLayer(RangeConfig(decay=1.0)), feed_cones),
    "glass": (GlassLayer, feed_glass),
    "blocked": (BlockedLayer, feed_blocked),
    "added": (AddedLayer, feed_blocked),
    "boundary": (BoundaryLayer, feed_boundary),
    "voxels": (lambda: VoxelLayer(VoxelConfig(), 1.0), feed_views),
    "keep_out": (KeepOutLayer, feed_zones),
}
every_layer = pytest.mark.parametrize("name", LAYERS)


def drawn(layer: Layer, spec: GridSpec, below: np.ndarray) -> np.ndarray:
    out = below.copy()
    layer.draw_into(out, spec, whole(spec))
    return out


def moment(rng: np.random.Generator) -> Moment:
    pose = SE2(*(float(v) for v in rng.uniform(-0.5, 0.5, 3)))
    return Moment(pose, SE2(float(rng.uniform(-0.2, 0.2))), pose.transform(FOOTPRINT) if rng.random() < 0.5 else None)


@every_layer
@pytest.mark.parametrize("seed", range(8))
def test_what_it_draws_differs_only_within_the_box_that_it_tells(name: str, seed: int) -> None:
    make, feed = LAYERS[name]
    layer, rng = make(), np.random.default_rng(seed)
    below = rng.choice(np.array([0, 100, 254, 255], np.uint8), SPEC.shape)
    feed(layer, rng, SPEC)
    layer.update(SPEC, moment(rng))
    before, seen = drawn(layer, SPEC, below), 0
    for k in range(30):
        if k % 3:
            feed(layer, rng, SPEC)
        if k == 20:
            layer.clear()
        box = layer.update(SPEC, moment(rng))
        after = drawn(layer, SPEC, below)
        differing = after != before
        seen += bool(differing.any())
        if box is not None:
            assert 0 <= box[0] < box[1] <= SPEC.height
            assert 0 <= box[2] < box[3] <= SPEC.width
            differing[box[0] : box[1], box[2] : box[3]] = False
        assert not differing.any()
        before = after
    assert seen >= 5, "a test of nothing"


@every_layer
def test_without_news_there_is_nothing_to_draw(name: str) -> None:
    make, feed = LAYERS[name]
    layer, rng = make(), np.random.default_rng(1)
    feed(layer, rng, SPEC)
    now = Moment(costmap_from_map=SE2())
    layer.update(SPEC, now)
    assert layer.update(SPEC, now) is None


@every_layer
def test_a_box_is_drawn_right_whatever_is_outside(name: str) -> None:
    make, feed = LAYERS[name]
    layer, rng = make(), np.random.default_rng(2)
    for _ in range(5):
        feed(layer, rng, SPEC)
        layer.update(SPEC, Moment(costmap_from_map=SE2()))
    below = rng.choice(np.array([0, 254, 255], np.uint8), SPEC.shape)
    part, all_of_it = below.copy(), drawn(layer, SPEC, below)
    box = (5, 20, 8, 31)
    layer.draw_into(part, SPEC, box)
    np.testing.assert_array_equal(part[5:20, 8:31], all_of_it[5:20, 8:31])


@every_layer
def test_it_keeps_its_place_when_the_grid_grows(name: str) -> None:
    if name == "static":
        return  # it has no place but its map's
    make, feed = LAYERS[name]
    layer, rng = make(), np.random.default_rng(6)
    now = Moment(costmap_from_map=SE2())
    for _ in range(6):
        feed(layer, rng, SPEC)
        layer.update(SPEC, now)
    before = drawn(layer, SPEC, np.zeros(SPEC.shape, np.uint8))
    layer.update(GROWN, now)
    after = drawn(layer, GROWN, np.zeros(GROWN.shape, np.uint8))
    dy, dx = SPEC.offset_in(GROWN)
    np.testing.assert_array_equal(after[dy : dy + SPEC.height, dx : dx + SPEC.width], before)
    assert (before == 254).any()


@pytest.mark.parametrize("name", ["obstacles", "cones", "voxels"])
def test_what_sensors_saw_is_forgotten_within_a_radius_and_nowhere_else(name: str) -> None:
    make, feed = LAYERS[name]
    layer, rng, below = make(), np.random.default_rng(4), np.zeros(SPEC.shape, np.uint8)
    before = below
    while (before == 254).sum() < 4:
        feed(layer, rng, SPEC)
        layer.update(SPEC, Moment())
        before = drawn(layer, SPEC, below)
    cells = np.argwhere(before == 254)
    x, y = SPEC.center_of(*cells[len(cells) // 2].tolist())
    near = cells_within(SPEC, x, y, 0.06)
    clear_layers([layer], x, y, 0.06)
    box = layer.update(SPEC, Moment())
    after = drawn(layer, SPEC, below)
    assert (before[near] == 254).any()
    assert not (after[near] == 254).any()
    np.testing.assert_array_equal(after[~near], before[~near])
    assert (after == 254).any()
    assert box is not None


def test_places_that_people_told_are_not_forgotten() -> None:
    layer = BoundaryLayer()
    layer.set_corners(np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]))
    now = Moment(costmap_from_map=SE2())
    layer.update(SPEC, now)
    before = drawn(layer, SPEC, np.zeros(SPEC.shape, np.uint8))
    clear_layers([layer], 0.0, 0.0, 5.0)
    layer.clear()
    layer.update(SPEC, now)
    np.testing.assert_array_equal(drawn(layer, SPEC, np.zeros(SPEC.shape, np.uint8)), before)
    with pytest.raises(BadInputError, match="three corners"):
        layer.set_corners(np.zeros((2, 2)))
    with pytest.raises(BadInputError, match="three corners"):
        layer.set_corners(np.full((3, 2), np.nan))


def test_a_boundary_is_closed_whatever_its_sides_lean() -> None:
    """Nobody who goes from cell to cell over their sides gets out of it."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, 6))
        layer = BoundaryLayer()
        corners = 1.3 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        layer.set_corners(corners)
        layer.update(SPEC, Moment(costmap_from_map=SE2()))
        line = drawn(layer, SPEC, np.zeros(SPEC.shape, np.uint8)) == 254
        regions, _ = label(~line)
        inside = SPEC.cell_of(*corners.mean(axis=0).tolist())
        if not line[inside]:
            assert regions[inside] != regions[0, 0]


def test_of_a_huge_boundary_only_what_the_grid_holds_is_drawn() -> None:
    """A side that begins and ends a million kilometres away is drawn where it crosses the grid, in as many points as that needs."""
    layer, far = BoundaryLayer(), 1e9
    layer.set_corners(np.array([[0.33, -far], [far, -far], [far, far], [0.33, far]]))
    assert layer.update(SPEC, Moment(costmap_from_map=SE2())) is not None
    line = drawn(layer, SPEC, np.zeros(SPEC.shape, np.uint8)) == 254
    expected = np.zeros(SPEC.shape, bool)
    expected[:, SPEC.cell_of(0.33, 0.0)[1]] = True
    np.testing.assert_array_equal(line, expected)
    assert len(layer._line) < 1000


def test_boxes() -> None:
    assert box_around(np.array([[-0.05, 0.05], [0.36, 0.21]]), SPEC) == (14, 19, 18, 25)
    assert box_around(np.array([[9.0, 9.0]]), SPEC) is None
    assert box_around(np.zeros((0, 2)), SPEC) is None
    assert union((1, 2, 3, 4), (0, 2, 9, 10)) == (0, 2, 3, 10)
    assert union(None, (1, 2, 3, 4)) == (1, 2, 3, 4) == union((1, 2, 3, 4), None)
    assert union(None, None) is None
