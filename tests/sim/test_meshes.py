"""Triangle meshes and height fields as rays see them: done by hand, beside a brute-force twin, and beside MuJoCo's rays."""

import math

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.kernels import bvh, raycast
from ambler.sim.base import PlacedRobot
from ambler.sim.contact_physics import build_mjcf
from ambler.sim.meshes import MIN_ALTITUDE, HeightField, TriangleMesh, highest_below
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import load_world

F64 = NDArray[np.float64]
CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
CUBE_FACES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
CUBE_TRIANGLES = np.array([t for a, b, c, d in CUBE_FACES for t in ((a, b, c), (a, c, d))])


def unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def ball(rng: np.random.Generator, count: int = 300) -> TriangleMesh:
    """A lumpy closed surface about (0, 0, 2), neither convex nor symmetrical."""
    from scipy.spatial import ConvexHull

    ways = unit(rng.standard_normal((count, 3)))
    triangles = ConvexHull(ways).simplices
    corners = ways[triangles]
    inwards = np.einsum(
        "ki,ki->k", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]
    )
    triangles[inwards < 0] = triangles[inwards < 0][:, ::-1]
    return TriangleMesh("ball", ways * rng.uniform(0.7, 1.3, (count, 1)) + [0.0, 0.0, 2.0], triangles)


def hills(rng: np.random.Generator, yaw: float = 0.4) -> HeightField:
    return HeightField("hills", rng.uniform(-0.3, 0.5, (14, 19)), 0.5, SE2(-4.0, -3.0, yaw))


def slow_cast(corners: F64, origin: F64, direction: F64) -> float:
    """Moeller and Trumbore's test against every triangle."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.einsum("ki,ki->k", e1, p)
        s = origin - corners[:, 0]
        u = scale * np.einsum("ki,ki->k", s, p)
        q = np.cross(s, e1)
        v, t = scale * (q @ direction), scale * np.einsum("ki,ki->k", e2, q)
    met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
    return float(t[met].min(initial=math.inf))


def test_a_slope_done_by_hand() -> None:
    """A roof of 45 degrees over x: from above, from below, level, and past its edge."""
    roof = TriangleMesh(
        "roof", np.array([[0.0, -1, 1], [1, -1, 2], [1, 1, 2], [0, 1, 1]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    scene = build_scene(WorldSpec("roof", (), SE2(), meshes=(roof,)))
    origins = np.array([[0.25, 0.5, 3.0], [0.25, 0.5, 0.25], [-1.0, 0.5, 1.75], [-1.0, 1.1, 1.75]])
    directions = np.array([[0.0, 0, -1], [0, 0, 1], [1, 0, 0], [1, 0, 0]])
    distance, hit, cosine = scene.cast(origins, directions)
    np.testing.assert_allclose(distance, [1.75, 1.0, 1.75, np.inf], atol=1e-12)
    np.testing.assert_allclose(cosine[:3], math.sqrt(0.5), atol=1e-12)
    assert hit[3] == raycast.NOTHING
    assert scene.solids.albedos[hit[0]] == 0.6


@pytest.mark.parametrize("seed", range(4))
def test_equals_the_brute_force_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh, field = ball(rng), hills(rng)
    scene = build_scene(WorldSpec("w", (), SE2(), meshes=(mesh,), terrain=field))
    corners = np.concatenate([field.corners, mesh.corners])
    origins = np.column_stack([rng.uniform(-4, 4, (400, 2)), rng.uniform(0.0, 4.0, 400)])
    directions = unit(rng.standard_normal((400, 3)))
    ours, hit, cosine = scene.cast(origins, directions)
    theirs = np.array([slow_cast(corners, o, d) for o, d in zip(origins, directions, strict=True)])
    on_floor = hit == raycast.FLOOR
    assert (theirs[on_floor] > ours[on_floor]).all()
    np.testing.assert_allclose(ours[~on_floor], theirs[~on_floor], atol=1e-9)
    met = np.nonzero(hit >= 0)[0]
    assert len(met) > 80
    sides = corners[scene.order[hit[met]]]
    normals = unit(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]))
    np.testing.assert_allclose(cosine[met], np.abs(np.einsum("ki,ki->k", normals, directions[met])), atol=1e-12)


def test_no_ray_slips_through_common_edges_and_corners() -> None:
    """From inside a closed surface, rays aimed exactly at corners and at points of edges all end where they aim."""
    rng = np.random.default_rng(3)
    mesh = ball(rng, 800)
    scene = build_scene(WorldSpec("w", (), SE2(), meshes=(mesh,)))
    edges = np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]]])
    share = rng.uniform(0.0, 1.0, (len(edges), 1))
    on_edges = mesh.vertices[edges[:, 0]] * (1 - share) + mesh.vertices[edges[:, 1]] * share
    for aims in (mesh.vertices, on_edges):
        for origin in (np.array([0.0, 0.0, 2.0]), np.array([0.1, -0.05, 2.03])):
            ways = aims - origin
            distance, _, _ = scene.cast(np.tile(origin, (len(aims), 1)), unit(ways))
            assert np.isfinite(distance).all()
            if origin[0] == 0.0:  # star-shaped about its middle: nothing stands before the aim
                np.testing.assert_allclose(distance, np.linalg.norm(ways, axis=1), atol=1e-6)


def test_grid_lines_of_a_field_let_no_ray_through() -> None:
    field = HeightField("flat", np.zeros((11, 11)), 0.1, SE2())
    scene = build_scene(WorldSpec("w", (), SE2(), terrain=field))
    x, y = (c.ravel() for c in np.meshgrid(*2 * [np.linspace(0.0, 1.0, 41)]))
    for tilt in (0.0, 0.3):
        way = unit(np.array([tilt, 0.0, -1.0]))
        origins = np.column_stack([x, y, np.zeros_like(x)]) - 2.0 * way
        distance, hit, _ = scene.cast(origins, np.tile(way, (len(x), 1)))
        np.testing.assert_allclose(distance, 2.0, atol=1e-9)
        assert (hit >= 0).all()


def test_rays_in_the_plane_of_a_triangle_pass_and_grazing_ones_hit() -> None:
    plate = TriangleMesh("plate", np.array([[0.0, -1, 1], [2, -1, 1], [1, 1, 1]]), np.array([[0, 1, 2]]))
    scene = build_scene(WorldSpec("w", (), SE2(), meshes=(plate,)))
    down = unit(np.array([1.0, 0.0, -1e-5]))
    directions = np.stack([np.array([1.0, 0.0, 0.0]), down])
    distance, hit, cosine = scene.cast(np.array([[-1.0, 0.0, 1.0], [-1.0, 0.0, 1.00002]]), directions)
    assert hit.tolist() == [raycast.NOTHING, 0]
    assert distance[1] == pytest.approx(2.0, abs=1e-6)
    assert cosine[1] == pytest.approx(1e-5, rel=1e-6)


def mujoco_rays(world: WorldSpec, origin: F64, directions: F64) -> F64:
    model = mujoco.MjModel.from_xml_string(build_mjcf(world, [PlacedRobot("robot", robot_named("diff"), SE2())], 0.005))
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    mujoco.mj_forward(model, data)
    n, base = len(directions), int(model.body("robot/base").id)
    geoms, distance = np.zeros(n, np.int32), np.zeros(n)
    mujoco.mj_multiRay(model, data, origin, directions.ravel(), None, 1, base, geoms, distance, None, n, 1e3)
    return np.where(distance < 0, np.inf, distance)


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_mujoco_on_height_fields(seed: int) -> None:
    """Cells are far from flat, so that the other diagonal would differ by decimetres."""
    rng = np.random.default_rng(seed)
    world = WorldSpec("w", (), SE2(), terrain=hills(rng))
    scene = build_scene(world)
    for origin in ([0.3, 0.4, 1.5], [-2.0, 1.0, 0.8]):
        directions = unit(rng.standard_normal((3000, 3)) * [1.0, 1.0, 0.4])
        ours, _, _ = scene.cast(np.tile(origin, (3000, 1)), directions)
        theirs = mujoco_rays(world, np.array(origin), directions)
        inside = np.isfinite(ours) & (ours < 6.0)
        differ = inside & ~np.isclose(ours, theirs, atol=1e-4)
        assert inside.sum() > 500
        assert differ.sum() <= 3  # rays that graze a ridge


def test_agrees_with_mujoco_on_meshes() -> None:
    """MuJoCo's own mesh geom: its rays meet the triangles themselves."""
    rng = np.random.default_rng(1)
    mesh = ball(rng)
    text = " ".join(map(repr, mesh.vertices.ravel().tolist()))
    faces = " ".join(map(str, mesh.triangles.ravel().tolist()))
    xml = (
        f'<mujoco><asset><mesh name="m" vertex="{text}" face="{faces}"/></asset>'
        '<worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(xml)
    # MuJoCo moves a mesh to its centre of mass and turns it to its main axes; the geom's pose undoes that.
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    origin, directions = np.array([2.5, 0.5, 2.2]), unit(rng.standard_normal((3000, 3)) - [2.0, 0.0, 0.0])
    distance, geoms = np.zeros(3000), np.zeros(3000, np.int32)
    mujoco.mj_multiRay(model, data, origin, directions.ravel(), None, 1, -1, geoms, distance, None, 3000, 1e3)
    ours, hit, _ = build_scene(WorldSpec("w", (), SE2(), meshes=(mesh,))).cast(np.tile(origin, (3000, 1)), directions)
    ours = np.where(hit >= 0, ours, np.inf)
    theirs = np.where(distance < 0, np.inf, distance)
    assert np.isfinite(theirs).sum() > 800
    same = np.isclose(ours, theirs, atol=1e-4) | (np.isinf(ours) & np.isinf(theirs))
    assert np.count_nonzero(~same) <= 3


@pytest.mark.parametrize("raised", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_mujocos_contact_and_rays_split_cells_as_we_do(raised: tuple[int, int]) -> None:
    """In the middle of a cell with one raised corner the height tells the diagonal: 0.5 on it, 0 beside it."""
    heights = np.zeros((2, 2))
    heights[raised] = 1.0
    field = HeightField("cell", heights, 1.0, SE2(-0.5, -0.5, 0.0))
    assert field.heights_at(np.zeros((1, 2)))[0] == (0.5 if raised[0] == raised[1] else 0.0)
    world = WorldSpec("w", (), SE2(), terrain=field)
    place = np.array([[0.003, 0.002]])
    expected = field.heights_at(place)[0]
    assert highest_below(field.corners, place, 9.0)[0] == pytest.approx(expected, abs=1e-12)
    origin = np.array([*place[0], 3.0])
    assert 3.0 - mujoco_rays(world, origin, np.array([[0.0, 0.0, -1.0]]))[0] == pytest.approx(expected, abs=1e-6)
    probe = '<body name="probe"><freejoint/><geom name="probe" type="sphere" size="0.001" mass="1"/></body></worldbody>'
    model = mujoco.MjModel.from_xml_string(
        build_mjcf(world, [PlacedRobot("robot", robot_named("diff"), SE2())], 0.005).replace("</worldbody>", probe)
    )
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    touching = []
    for z in (expected - 0.004, expected + 0.004):
        data.qpos[-7:-4] = [*place[0], z]
        mujoco.mj_forward(model, data)
        touching.append(any("probe" in model.geom(int(g)).name for c in data.contact for g in c.geom))
    assert touching == [True, False]


def test_heights_and_triangles_of_a_field_are_the_same_surface() -> None:
    rng = np.random.default_rng(0)
    field = hills(rng)
    points = rng.uniform(-5.0, 6.0, (400, 2))
    heights, met = field.heights_at(points), highest_below(field.corners, points, 9.0)
    assert 50 < np.isnan(heights).sum() < 350
    np.testing.assert_array_equal(np.isnan(heights), np.isinf(met))
    np.testing.assert_allclose(heights[~np.isnan(heights)], met[np.isfinite(met)], atol=1e-12)
    moved = field.moved(SE2(1.0, 2.0, 0.3))
    np.testing.assert_allclose(moved.heights_at(SE2(1.0, 2.0, 0.3).transform(points)), heights, atol=1e-9)


def test_closed_or_not() -> None:
    assert TriangleMesh("cube", CUBE, CUBE_TRIANGLES).is_closed
    assert not TriangleMesh("open", CUBE, CUBE_TRIANGLES[1:]).is_closed
    soup = TriangleMesh("soup", CUBE[CUBE_TRIANGLES].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert soup.is_closed
    turned = CUBE_TRIANGLES.copy()
    turned[0] = turned[0][::-1]
    assert not TriangleMesh("inside_out", CUBE, turned).is_closed


@pytest.mark.parametrize(
    ("vertices", "triangles", "words"),
    [
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "triangle 0 has no area"),
        ([[0, 0, 0], [1, 0, 0], [0.5, MIN_ALTITUDE / 2, 0]], [[0, 1, 2]], "triangle 0 has no area"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 1]], "triangle 1 has no area"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "triangle 0 names a vertex"),
        ([[0, 0, 0], [1, 0, 0], [0, math.nan, 0]], [[0, 1, 2]], "vertex 2 is no point"),
        ([[0, 0, 0]], np.zeros((0, 3)), "no triangles"),
        ([[0, 0]], [[0, 0, 0]], "vertices"),
    ],
)
def test_broken_meshes_are_refused_by_name(vertices: object, triangles: object, words: str) -> None:
    with pytest.raises(BadInputError, match=f"mesh 'heap': .*{words}"):
        TriangleMesh("heap", np.array(vertices, float), np.array(triangles, int))


@pytest.mark.parametrize(
    ("heights", "resolution", "words"),
    [
        ([[0.0, 1.0]], 0.1, "2 x 2"),
        ([[0.0, 1.0], [math.inf, 0.0]], 0.1, "row 1, column 0"),
        ([[0.0, 1.0], [0.0, 0.0]], 0.0, "resolution"),
    ],
)
def test_broken_fields_are_refused_by_name(heights: list[list[float]], resolution: float, words: str) -> None:
    with pytest.raises(BadInputError, match=f"height field 'bog': .*{words}"):
        HeightField("bog", np.array(heights), resolution, SE2())


def slow_build(lower: F64, upper: F64) -> tuple[list[int], list[tuple[list[float], int, int]]]:
    """The tree by the definition of the heuristic: every cut along every axis, from scratch."""

    def area(members: list[int]) -> float:
        x, y, z = upper[members].max(axis=0) - lower[members].min(axis=0)
        return float(x * y + y * z + z * x)

    middle = 0.5 * (lower + upper)
    order = list(range(len(lower)))
    nodes: list[tuple[list[float], int, int]] = [([], 0, 0)]
    waiting = [(0, 0, len(lower))]
    while waiting:
        node, a, b = waiting.pop()
        members = order[a:b]
        bounds = [*lower[members].min(axis=0), *upper[members].max(axis=0)]
        if b - a == 1:
            nodes[node] = (bounds, a, 1)
            continue
        rows = [sorted(members, key=lambda k, j=axis: middle[k, j]) for axis in range(3)]
        cuts = [
            (area(r[:s]) * s + area(r[s:]) * (b - a - s), i, s) for i, r in enumerate(rows) for s in range(1, b - a)
        ]
        _, axis, size = min(cuts)
        order[a:b] = rows[axis]
        nodes[node] = (bounds, len(nodes), 0)
        waiting += [(len(nodes), a, a + size), (len(nodes) + 1, a + size, b)]
        nodes += [([], 0, 0), ([], 0, 0)]
    return order, nodes


def test_the_hierarchy_equals_its_slow_twin() -> None:
    rng = np.random.default_rng(2)
    lower = rng.uniform(-5, 5, (60, 3))
    upper = lower + rng.uniform(0.01, 2.0, (60, 3))
    order, bounds = np.empty(60, np.int32), np.empty((119, 6))
    firsts, counts = np.empty(119, np.int32), np.empty(119, np.int32)
    assert bvh.build(lower, upper, order, bounds, firsts, counts) == 119
    slow_order, nodes = slow_build(lower, upper)
    assert order.tolist() == slow_order
    np.testing.assert_array_equal(bounds, [n[0] for n in nodes])
    assert firsts.tolist() == [n[1] for n in nodes]
    assert counts.tolist() == [n[2] for n in nodes]


def test_no_tree_is_deeper_than_the_stack_of_the_rays() -> None:
    """Boxes from one corner, each twice as large as the one before: the cheapest cut always splits off one."""
    upper = np.repeat(2.0 ** np.arange(-60.0, 90.0)[:, None], 3, axis=1)
    order, bounds = np.empty(150, np.int32), np.empty((299, 6))
    firsts, counts = np.empty(299, np.int32), np.empty(299, np.int32)
    bvh.build(0.0 * upper, upper, order, bounds, firsts, counts)
    depth, deepest = np.zeros(299, int), 0
    for node in range(299):
        if counts[node] == 0:
            depth[firsts[node] : firsts[node] + 2] = depth[node] + 1
        deepest = max(deepest, depth[node])
    assert bvh.DEEP < deepest < raycast.STACK - 1


def test_a_world_seen_from_elsewhere_is_the_same_for_rays_and_for_the_ground() -> None:
    """Meshes and terrain move with the solids, whichever frame tells of them."""
    world, world_from_frame = load_world("ramp"), SE2(4.0, -3.0, 0.7)
    assert world.meshes
    assert world.terrain is not None
    seen, frame_from_world = world.seen_from(world_from_frame), world_from_frame.inverse()
    rng = np.random.default_rng(5)
    places = rng.uniform([0.5, 0.5], [20.0, 7.5], (400, 2))
    heights = world.ground_at(places[:1])
    assert seen.ground_at(frame_from_world.transform(places[:1])) == pytest.approx(heights, abs=1e-9)
    np.testing.assert_allclose(
        seen.terrain.heights_at(frame_from_world.transform(places)) if seen.terrain is not None else np.nan,
        world.terrain.heights_at(places),
        atol=1e-9,
    )
    origins = np.column_stack([places, np.full(400, 1.2)])
    directions = unit(rng.standard_normal((400, 3)) * [1.0, 1.0, 0.3])
    spun = SE2(0.0, 0.0, frame_from_world.yaw)
    here, _, _ = build_scene(world).cast(origins, directions)
    there, _, _ = build_scene(seen).cast(
        np.column_stack([frame_from_world.transform(places), origins[:, 2]]),
        np.column_stack([spun.transform(directions[:, :2]), directions[:, 2]]),
    )
    assert np.isfinite(here).sum() > 300
    np.testing.assert_allclose(there, here, atol=1e-6)
