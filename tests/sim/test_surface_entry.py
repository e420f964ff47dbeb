"""Meshes and terrain in world files: where they come to lie, and one sentence for every mistake."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.world_file import load_world

START = "start: {x: 1.0, y: 2.0, yaw_deg: 90}\n"
TRIANGLE = "v 0 0 0\nv 2 0 0\nv 0 1 1\nf 1 2 3\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "w.yaml"
    path.write_text(START + text)
    return path


def test_a_mesh_is_scaled_turned_and_moved_and_seen_from_the_start(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text(TRIANGLE)
    text = "meshes: [{file: t.obj, at: [4, 2, 0.5], yaw_deg: 90, scale: 2, albedo: 0.2}]"
    world = load_world(write(tmp_path, text))
    (mesh,) = world.meshes
    assert (mesh.name, mesh.albedo) == ("t", 0.2)
    np.testing.assert_allclose(mesh.vertices, [[4, 2, 0.5], [4, 6, 0.5], [2, 2, 2.5]], atol=1e-12)
    # Seen from the start, x is the author's y.
    (mesh,) = world.from_start().meshes
    np.testing.assert_allclose(mesh.vertices, [[0, -3, 0.5], [4, -3, 0.5], [0, -1, 2.5]], atol=1e-12)


def test_terrain_between_lines(tmp_path: Path) -> None:
    text = "terrain: {resolution: 0.5, x: [0, 1, 3], y: [0, 2], heights: [[0, 1, 1], [0, 2, 2]], corner: [1, 2]}"
    world = load_world(write(tmp_path, text))
    field = world.terrain
    assert field is not None
    assert field.heights.shape == (5, 7)
    np.testing.assert_allclose(field.heights[2], [0.0, 0.75, 1.5, 1.5, 1.5, 1.5, 1.5])
    assert field.origin.distance_to(SE2(1.0, 2.0, 0.0)) < 1e-12
    assert world.floor == -0.005
    assert field.heights_at(np.array([[3.0, 3.0]]))[0] == pytest.approx(1.5)
    seen = world.from_start().terrain
    assert seen is not None
    assert seen.origin.distance_to(SE2(0.0, 0.0, -math.pi / 2)) < 1e-12
    assert seen.heights_at(np.array([[1.0, -2.0]]))[0] == pytest.approx(1.5)


@pytest.mark.parametrize(("kind", "full"), [(np.uint16, 65535), (np.uint8, 255)])
def test_terrain_from_a_picture_whose_upper_edge_is_far_in_y(tmp_path: Path, kind: type, full: int) -> None:
    cv2.imwrite(str(tmp_path / "h.png"), np.array([[0, full, full], [0, 0, full]], kind))
    field = load_world(write(tmp_path, "terrain: {file: h.png, range: [-1, 3], resolution: 0.2}")).terrain
    assert field is not None
    np.testing.assert_allclose(field.heights, [[-1, -1, 3], [-1, 3, 3]])


def test_terrain_from_an_array_in_metres(tmp_path: Path) -> None:
    heights = np.array([[0.0, 0.25], [0.5, 0.75], [1.0, 2.0]], np.float32)
    np.save(tmp_path / "h.npy", heights)
    field = load_world(write(tmp_path, "terrain: {file: h.npy, resolution: 0.2, name: lawn}")).terrain
    assert field is not None
    assert (field.name, field.resolution) == ("lawn", 0.2)
    np.testing.assert_array_equal(field.heights, heights)


def test_a_world_inherits_meshes_and_terrain_with_files_beside_their_own_world(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "t.obj").write_text(TRIANGLE)
    base = write(
        tmp_path / "far",
        "meshes: [{file: t.obj}]\nterrain: {resolution: 1, x: [0, 1], y: [0, 1], heights: [[0, 0], [0, 0]]}",
    )
    (tmp_path / "u.obj").write_text(TRIANGLE)
    world = load_world(write(tmp_path, f"extends: {base}\nmeshes: [{{file: u.obj}}]"))
    assert [m.name for m in world.meshes] == ["t", "u"]
    assert world.terrain is not None


GRID = "terrain: {resolution: 0.5, x: [0, 1], y: [0, 1], heights: [[0, 1], [0, 1]]"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("meshes: [{file: nothing.obj}]", r"nothing\.obj: cannot be read"),
        ("meshes: [{file: bad.obj}]", r"bad\.obj: is no mesh"),
        ("meshes: [{file: flat.obj}]", r"flat\.obj: mesh 'flat': triangle 0 has no area"),
        ("meshes: [{name: no_file}]", r"w\.yaml: meshes\.0: .*either file, or vertices and triangles"),
        (
            "meshes: [{file: t.obj, triangles: [[0, 1, 2]]}]",
            r"w\.yaml: meshes\.0: .*either file, or vertices and triangles",
        ),
        ("meshes: [{triangles: [[0, 1, 2]]}]", r"w\.yaml: mesh 'w': triangle 0 names a vertex"),
        (
            "meshes: [{name: m, vertices: [[0, 0, 0], [1, 0, 0], [2, 0, 0]], triangles: [[0, 1, 2]]}]",
            r"w\.yaml: mesh 'm': triangle 0 has no area",
        ),
        ("meshes: [{file: t.obj, scale: 0}]", r"w\.yaml: meshes\.0\.scale"),
        ("terrain: {resolution: 0.5}", "either file or x, y and heights"),
        (GRID + ", file: h.npy}", "either file or x, y and heights"),
        (GRID + ", range: [0, 1]}", "range belongs to pictures"),
        (GRID.replace("[0, 1]]", "[0, 1, 2]]") + "}", "2 rows"),
        (GRID.replace("x: [0, 1]", "x: [1, 0]") + "}", "must grow"),
        (GRID.replace("resolution: 0.5", "resolution: 0.0001") + "}", "w.yaml: terrain 'terrain': .* too many"),
        ("terrain: {file: h.png, resolution: 1}", r"h\.png: range: is missing"),
        ("terrain: {file: none.png, range: [0, 1], resolution: 1}", r"none\.png: not readable"),
        ("terrain: {file: colour.png, range: [0, 1], resolution: 1}", r"colour\.png: .* one channel"),
        ("terrain: {file: none.npy, resolution: 1}", r"none\.npy: not readable"),
        ("terrain: {file: words.npy, resolution: 1}", r"words\.npy: .* real numbers"),
        ("terrain: {file: nan.npy, resolution: 1}", r"nan\.npy: height field 'terrain': .* row 0, column 1"),
    ],
)
def test_mistakes_get_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0\n")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    cv2.imwrite(str(tmp_path / "h.png"), np.zeros((3, 3), np.uint16))
    cv2.imwrite(str(tmp_path / "colour.png"), np.zeros((3, 3, 3), np.uint8))
    np.save(tmp_path / "words.npy", np.array([["a", "b"], ["c", "d"]]))
    np.save(tmp_path / "nan.npy", np.array([[0.0, np.nan], [0.0, 0.0]]))
    with pytest.raises(BadInputError, match=words) as caught:
        load_world(write(tmp_path, text))
    assert "\n" not in str(caught.value)
