"""Drawn places with three dimensions: they load again as they were drawn, a robot gets along their routes, and they are what they say."""

import math
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.sim.generator.content import content_of
from ambler.sim.generator.draw import draw_place
from ambler.sim.generator.spatial import KERB, RAMP, SPATIAL_KINDS, STOREY, garage
from ambler.sim.generator.view import heights_from_above
from ambler.sim.generator.write import write_place
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import load_world, world_from_content


def along(world: WorldSpec, step: float = 0.25) -> np.ndarray:
    """Points (N, 2) along a world's route."""
    parts = [np.linspace(a, b, max(2, math.ceil(math.dist(a, b) / step))) for a, b in pairwise(np.array(world.route))]
    return np.concatenate(parts)


@pytest.mark.parametrize("kind", SPATIAL_KINDS)
def test_a_written_place_loads_again_as_it_was_drawn(kind: str, tmp_path: Path) -> None:
    place = draw_place(kind, 5)
    write_place(tmp_path / "place.yaml", place)
    again, named = load_world(tmp_path / "place.yaml"), load_world(f"{kind}-5")
    for world in (again, named):
        assert (world.solids, world.people, world.route, world.start) == (
            *(place.world.solids, place.world.people, place.world.route, place.world.start),
        )
        for a, b in zip(world.meshes, place.world.meshes, strict=True):
            np.testing.assert_array_equal(a.corners, b.corners)
        if place.world.terrain is not None:
            assert world.terrain is not None
            np.testing.assert_array_equal(world.terrain.corners, place.world.terrain.corners)
    assert draw_place(kind, 6).world.solids != place.world.solids


@pytest.mark.parametrize("kind", SPATIAL_KINDS)
def test_what_is_written_is_what_was_drawn_to_a_millimetre(kind: str) -> None:
    drawn = SPATIAL_KINDS[kind](8)
    world = world_from_content(Path("w"), content_of(drawn))
    assert [s.name for s in world.solids if s.size_x != s.size_y] != []
    by_name = sorted(drawn.solids, key=lambda s: (s.shape, drawn.solids.index(s)))
    for a, b in zip(world.solids, by_name, strict=True):
        assert (a.name, a.shape, a.albedo) == (b.name, b.shape, b.albedo)
        assert a.world_from_solid.distance_to(b.world_from_solid) < 1e-3
        assert (a.size_x, a.size_y, a.z_min, a.z_max) == pytest.approx((b.size_x, b.size_y, b.z_min, b.z_max), abs=2e-3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["site", "tunnel"])
def test_a_robot_gets_along_the_whole_route(kind: str, seed: int) -> None:
    """Nothing stands in the way of a disc of 0.45 m, nothing is steeper than 20 degrees, and the start lies on it."""
    place = draw_place(kind, seed)
    points = along(place.world)
    cells = place.floor.spec.cells_of(points)
    assert place.floor.reached[cells[:, 0], cells[:, 1]].all()
    terrain = place.world.terrain
    if terrain is not None:
        heights = terrain.heights_at(points)
        assert np.isfinite(heights).all()
        assert 2.0 < np.ptp(heights) < 15.0


@pytest.mark.parametrize("seed", range(3))
def test_nothing_stands_on_the_route_through_both_levels_of_a_garage(seed: int) -> None:
    """A body of 0.5 m around and 1.3 m above every point of the route, at the height that the route has reached there."""
    world = garage(seed)
    height = 0.0
    reached = [0.0]
    for x, y in along(world, 0.1).tolist():
        height = float(world.ground_at(np.array([[x, y]]), height)[0])
        reached.append(height)
        for solid in world.solids:
            local = np.abs(solid.world_from_solid.inverse().transform(np.array([[x, y]]))[0])
            away = np.hypot(*np.maximum(local - 0.5 * np.array([solid.size_x, solid.size_y]), 0.0))
            is_level = solid.z_min < height + 1.3 and solid.z_max > height + 0.1
            assert away > 0.5 or not is_level, (solid.name, x, y, height)
    rises = np.abs(np.diff(reached))
    assert max(reached) == pytest.approx(STOREY, abs=1e-6)
    assert reached[-1] == 0.0
    assert rises.max() <= 0.101 * math.tan(RAMP)


def test_kerbs_stand_twelve_centimetres_over_the_ground_beside_the_way() -> None:
    world = load_world("campus")
    assert world.terrain is not None
    kerbs = [s for s in world.solids if s.name == "kerb"]
    assert len(kerbs) > 20
    way = along(world, 0.1)
    for kerb in kerbs:
        middle = np.array([[kerb.world_from_solid.x, kerb.world_from_solid.y]])
        ground = float(world.terrain.heights_at(middle)[0])
        assert kerb.z_max - ground == pytest.approx(KERB[0], abs=2e-3)
        assert 1.5 < np.hypot(*(way - middle).T).min() < 2.5


def test_the_built_in_worlds_are_drawn_ones() -> None:
    """So that whoever wants others like them knows how."""
    for name, drawn in (("campus", "site-10"), ("garage", "garage-1"), ("tunnel", "tunnel-1")):
        built_in, other = load_world(name), load_world(drawn)
        assert built_in.solids == other.solids, name
        assert built_in.route == other.route


def test_the_view_from_above_sees_the_ground_and_what_stands_on_it() -> None:
    world = load_world("garage")
    below, above = (heights_from_above(world, 0.5, cut) for cut in (2.5, 1000.0))
    assert above.max() == pytest.approx(2.0 * STOREY, abs=1e-6)
    assert below.max() <= 2.5
    assert np.median(below) == pytest.approx(0.0, abs=1e-6)


def test_a_world_is_shown_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["world", "show", "campus", "--picture", str(tmp_path / "c.png"), "--json", str(tmp_path / "c.json")]) == 0
    )
    assert "a route of 300 m" in capsys.readouterr().out
    image = cv2.imread(str(tmp_path / "c.png"))
    assert image is not None
    assert max(image.shape[:2]) > 1000
    assert main(["world", "show", "campus", "--picture", str(tmp_path / "no" / "c.png")]) == 2
    assert main(["world", "show", "nowhere"]) == 2


def test_a_spatial_place_has_no_other_day() -> None:
    with pytest.raises(BadInputError, match="no furniture"):
        draw_place("site", 1, 2)
    with pytest.raises(BadInputError, match="site, plot, garage, tunnel"):
        draw_place("moon", 1)
