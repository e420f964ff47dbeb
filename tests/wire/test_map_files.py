"""Map files: round trip, every mode and image kind, the recorded maps, clear errors, fuzz."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.wire.map_files import load_bend, load_map, save_map
from tests.public_data import public

SPEC = GridSpec(0.05, 4, 3, -1.25, 2.5)
CELLS = np.array([[0, 100, -1, 0], [-1, -1, 100, 100], [0, 0, 0, -1]], np.int8)


def describe(tmp_path: Path, name: str, /, **changes: object) -> Path:
    table: dict[str, object] = {"image": name, "resolution": 0.1, "origin": [0, 0, 0], "negate": 0}
    table |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | changes
    path = tmp_path / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in table.items() if value is not None))
    return path


def test_round_trip(tmp_path: Path) -> None:
    image, description = save_map(tmp_path / "floor.v2", SPEC, CELLS)
    assert (image.name, description.name) == ("floor.v2.pgm", "floor.v2.yaml")
    spec, cells = load_map(description)
    assert spec == SPEC
    np.testing.assert_array_equal(cells, CELLS)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["floor.v2.pgm", "floor.v2.yaml"]


def test_pixels_are_those_of_map_saver_with_the_top_row_first(tmp_path: Path) -> None:
    image, _ = save_map(tmp_path / "m", SPEC, CELLS)
    pixels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(pixels, [[254, 254, 254, 205], [205, 205, 0, 0], [254, 0, 205, 254]])


@pytest.mark.parametrize("negate", [0, 1])
def test_trinary_thresholds_are_inclusive(tmp_path: Path, negate: int) -> None:
    p = np.array([[255, 192, 191, 90, 89, 0]], np.uint8)
    if negate:
        p = 255 - p
    cv2.imwrite(str(tmp_path / "m.png"), p)
    _, cells = load_map(describe(tmp_path, "m.png", negate=negate, free_thresh=63 / 255, occupied_thresh=166 / 255))
    assert cells.tolist() == [[0, 0, -1, -1, 100, 100]]


def test_scale_and_raw(tmp_path: Path) -> None:
    p = np.array([[255, 204, 128, 51, 0]], np.uint8)
    cv2.imwrite(str(tmp_path / "m.png"), p)
    _, cells = load_map(describe(tmp_path, "m.png", mode="scale", free_thresh=0.1, occupied_thresh=0.9))
    expected = [0, round((0.2 - 0.1) / 0.8 * 100), round((127 / 255 - 0.1) / 0.8 * 100), round(0.7 / 0.8 * 100), 100]
    assert cells[0] == pytest.approx(expected, abs=1)
    cv2.imwrite(str(tmp_path / "r.png"), np.array([[0, 37, 100, 101, 255]], np.uint8))
    assert load_map(describe(tmp_path, "r.png", mode="raw"))[1].tolist() == [[0, 37, 100, -1, -1]]


def test_colour_is_averaged_and_transparency_is_unknown(tmp_path: Path) -> None:
    bgr = np.array([[[255, 255, 255], [0, 0, 0], [0, 255, 255]]], np.uint8)
    cv2.imwrite(str(tmp_path / "c.png"), bgr)
    assert load_map(describe(tmp_path, "c.png"))[1].tolist() == [[0, 100, -1]]
    bgra = np.array([[[255, 255, 255, 255], [255, 255, 255, 0]]], np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), bgra)
    assert load_map(describe(tmp_path, "a.png", mode="scale"))[1].tolist() == [[0, -1]]
    assert load_map(describe(tmp_path, "a.png"))[1].tolist() == [[0, -1]]


def test_a_map_is_found_by_its_image_or_asks_for_its_yaml(tmp_path: Path) -> None:
    image, description = save_map(tmp_path / "floor", SPEC, CELLS, bend=(0.1, 0.02))
    np.testing.assert_array_equal(load_map(image)[1], CELLS)
    assert load_map(image)[0] == SPEC
    assert load_bend(image) == (0.1, 0.02)
    description.rename(tmp_path / "another.yaml")
    with pytest.raises(BadInputError, match="give the map's YAML"):
        load_map(image)
    description.write_text("image: something.png\nresolution: 0.1\norigin: [0, 0, 0]\n")
    with pytest.raises(BadInputError, match="give the map's YAML"):
        load_map(image)


@pytest.mark.parametrize("magic", ["P2", "P5", "P6"])
def test_netpbm_kinds_with_comments(tmp_path: Path, magic: str) -> None:
    values = [0, 254, 205]
    body = {
        "P2": b"0 254 205\n",
        "P5": bytes(values),
        "P6": bytes(v for v in values for _ in range(3)),
    }[magic]
    (tmp_path / "m.pgm").write_bytes(f"{magic}\n# made by hand\n3 1\n255\n".encode() + body)
    spec, cells = load_map(describe(tmp_path, "m.pgm"))
    assert (spec.width, spec.height, cells.tolist()) == (3, 1, [[100, 0, -1]])


@pytest.mark.parametrize("white", [15, 100, 255, 1023, 4095, 65535])
@pytest.mark.parametrize("magic", ["P2", "P5", "P6"])
def test_netpbm_values_are_shares_of_white(tmp_path: Path, magic: str, white: int) -> None:
    """Whatever number the header calls white, a picture of it means the same."""
    values = np.repeat(np.rint(white * np.array([0.0, 0.4, 0.81, 1.0])).astype(int), 3 if magic == "P6" else 1)
    body = values.astype(">u2" if white > 255 else np.uint8).tobytes()
    if magic == "P2":
        body = " ".join(map(str, values)).encode() + b"\n"
    (tmp_path / "m.pgm").write_bytes(f"{magic}\n# by hand\n4 1\n{white}\n".encode() + body)
    assert load_map(describe(tmp_path, "m.pgm", free_thresh=0.15))[1].tolist() == [[100, -1, -1, 0]]


@pytest.mark.parametrize("name", ["@home", "a: b", "- x", "floor #2", "%a", "'q", "größe " * 15])
def test_a_map_may_have_any_name(tmp_path: Path, name: str) -> None:
    """Names that YAML would read as something else are quoted."""
    _, description = save_map(tmp_path / name, SPEC, CELLS)
    np.testing.assert_array_equal(load_map(description)[1], CELLS)


@pytest.mark.parametrize(("name", "shape"), [("depot", (307, 604)), ("ac109_3", None)])
def test_recorded_maps_load(name: str, shape: tuple[int, int] | None) -> None:
    spec, cells = load_map(public(f"maps/{name}.yaml"))
    assert cells.shape == spec.shape
    assert shape in (None, cells.shape)
    assert set(np.unique(cells)) <= {-1, 0, 100}
    assert (cells == 0).sum() > 1000
    assert (cells == 100).sum() > 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": None}, "resolution is missing"),
        ({"resolution": "wide"}, "resolution is no number"),
        ({"resolution": 0}, "must be positive"),
        ({"origin": "[0]"}, "origin must be"),
        ({"origin": "[0, 0, .inf]"}, "origin is not finite"),
        ({"mode": "octal"}, "mode 'octal'"),
        ({"free_thresh": 0.9}, "thresholds"),
        ({"negate": 2}, "negate"),
        ({"image": "gone.pgm"}, r"gone\.pgm: No such file"),
        ({"image": "[1"}, "map.yaml"),
    ],
)
def test_errors_are_one_clear_line(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    save_map(tmp_path / "m", SPEC, CELLS)
    with pytest.raises(BadInputError, match=message) as caught:
        load_map(describe(tmp_path, "m.pgm", **changes))
    assert "\n" not in str(caught.value)


def test_truncated_and_garbled_images_are_refused_or_read_whole(tmp_path: Path) -> None:
    image, description = save_map(tmp_path / "m", SPEC, CELLS)
    good = image.read_bytes()
    for length in range(len(good)):
        image.write_bytes(good[:length])
        with pytest.raises(BadInputError, match=r"m\.pgm"):
            load_map(description)
    rng = np.random.default_rng(0)
    for _ in range(200):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] = rng.integers(256)
        image.write_bytes(bytes(bad))
        try:
            _, cells = load_map(description)
        except BadInputError:
            continue
        assert cells.size > 0


def test_a_wrong_shape_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="geometry"):
        save_map(tmp_path / "m", SPEC, CELLS[:2])


@pytest.mark.parametrize("yaw", [0.3, -2.0, math.pi / 2])
def test_a_turned_picture_is_drawn_along_the_axes_with_its_walls_closed(tmp_path: Path, yaw: float) -> None:
    """The origin's yaw turns the picture about its lowest left corner, as ROS means it."""
    cells = np.full((40, 60), -1, np.int8)
    cells[5:35, 5:55] = 0
    cells[10:30, 10:40] = 100
    cells[11:29, 11:39] = 0
    _, description = save_map(tmp_path / "m", GridSpec(0.05, 60, 40, -1.0, 2.0), cells)
    description.write_text(description.read_text().replace(", 0]", f", {yaw!r}]"))
    spec, drawn = load_map(description)
    map_from_picture = SE2(-1.0, 2.0, yaw)

    def shown(places: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        iy, ix = spec.cells_of(map_from_picture.transform((places[:, ::-1] + 0.5) * 0.05)).T
        return iy, ix

    for value in (100, 0, -1):
        inner = cells == value if value == 100 else ndimage.binary_erosion(cells == value, np.ones((3, 3), bool))
        assert set(drawn[shown(np.argwhere(inner))]) == {value}
    rooms, _ = ndimage.label(drawn == 0)
    inside, outside = rooms[shown(np.array([[20, 25], [7, 7]]))]
    assert 0 < inside != outside > 0, "nobody walks through a wall"
    if yaw == math.pi / 2:
        assert np.array_equal(drawn, np.rot90(cells, -1))


def test_a_map_says_how_far_it_is_bent_or_nothing(tmp_path: Path) -> None:
    _, plain = save_map(tmp_path / "plain", SPEC, CELLS)
    _, bent = save_map(tmp_path / "bent", SPEC, CELLS, (0.0123, 0.0045))
    assert load_bend(plain) == (0.0, 0.0)
    assert load_bend(bent) == (0.0123, 0.0045)
    assert np.array_equal(load_map(bent)[1], load_map(plain)[1])


@pytest.mark.parametrize("text", ["bend: 3", "bend: [1.0]", "bend: [-0.1, 0.0]", "bend: [a, b]", "bend: [.nan, 0]"])
def test_a_bend_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    _, description = save_map(tmp_path / "m", SPEC, CELLS)
    description.write_text(description.read_text() + text + "\n")
    with pytest.raises(BadInputError, match="bend"):
        load_bend(description)
