"""World files: what they mean, that the shipped ones are sane, and that mistakes get one clear line."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
from ambler.core.se2 import SE2
from ambler.sim.floorplan import merge_cells
from ambler.sim.kinematic_physics import FootprintCollider
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import reachable_cells, truth_grid
from ambler.sim.world_file import load_world, world_names
from ambler.wire.map_files import save_map
from tests.public_data import public

# The middle of each of the ten rooms of `office`, in the author's coordinates.
ROOMS = [
    *[(2.0, 10.5), (6.2, 10.0), (13.2, 11.2), (18.9, 11.5), (22.3, 11.0)],
    *[(3.2, 1.8), (7.6, 5.2), (12.3, 4.4), (15.0, 3.0), (21.3, 4.5)],
]


def write(folder: Path, text: str) -> Path:
    path = folder / "world.yaml"
    path.write_text(text)
    return path


def test_the_worlds_of_the_issue_are_there() -> None:
    wanted = {"lab_empty", "lab_obstacle", "office", "warehouse", "maze", "corridor", "building"}
    assert wanted <= set(world_names())


@pytest.mark.parametrize("name", ["warehouse", "maze", "corridor", "building"])
def test_every_robot_can_get_around_and_turn_in_the_wide_worlds(name: str) -> None:
    """A disc of 0.65 m, which passes openings of 1.5 m, comes near every place where `amr_omni` can stand at all."""
    world = load_world(name)
    spec, wide = reachable_cells(world, 0.65, 0.1, 0.25)
    _, narrow = reachable_cells(world, 0.42, 0.1, 0.25)
    near = ndimage.distance_transform_edt(~wide) * spec.resolution < 0.75
    assert (narrow & near).sum() > 0.97 * narrow.sum()
    assert ndimage.label(narrow)[1] == 1
    size = {"warehouse": 250, "maze": 60, "corridor": 90, "building": 280}[name]
    assert narrow.sum() * 0.01 > size


def test_the_corridor_is_long_and_has_few_features() -> None:
    x0, y0, x1, y1 = load_world("corridor").bounds()
    assert x1 - x0 == pytest.approx(60.12)
    assert y1 - y0 < 4.7
    assert len(load_world("corridor").solids) == 14


def test_racks_stand_on_posts_and_their_empty_bays_can_be_passed() -> None:
    world = load_world("warehouse")
    names = [s.name for s in world.solids]
    assert names.count("rack_a_post") == 14
    assert names.count("rack_a_pallet") == 5
    spec, reached = reachable_cells(world, 0.5, 0.1, 0.25)
    assert reached[spec.cell_of(6.0 + 3.5 * 2.7, 3.35)]


@pytest.mark.parametrize("name", ["easy/img_1", "medium/img_10", "complex/img_100"])
def test_pictures_of_the_exploration_benchmark_are_worlds(name: str) -> None:
    path = public(f"exploration/{name}.png")
    world = load_world(path)
    collider = FootprintCollider(world, robot_named("amr_omni"))
    assert all(not collider.overlapping(world.start @ SE2(0.0, 0.0, 0.1 * k)) for k in range(63))
    _, reached = reachable_cells(world, 0.5, 0.1, 0.25)
    assert reached.sum() * 0.01 > 200.0
    # The block that marks the start is where the robot starts.
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[::-1]
    start = world.start
    assert abs(int(pixels[int(start.y / 0.1), int(start.x / 0.1)]) - 203) <= 2


@pytest.mark.parametrize("name", ["depot", "ac109_3"])
def test_public_maps_are_worlds(name: str) -> None:
    world = load_world(public(f"maps/{name}.yaml"))
    collider = FootprintCollider(world, robot_named("diff"))
    assert not collider.overlapping(world.start)
    _, reached = reachable_cells(world, 0.3, 0.05, 0.25)
    assert reached.sum() * 0.0025 > {"depot": 100.0, "ac109_3": 0.9}[name]


def test_a_picture_without_a_start_begins_in_the_widest_place(tmp_path: Path) -> None:
    pixels = np.full((60, 80), 127, np.uint8)
    pixels[10:30, 10:30] = 194
    pixels[20:24, 30:70] = 194
    cv2.imwrite(str(tmp_path / "p.png"), pixels)
    world = load_world(tmp_path / "p.png")
    assert world.start.distance_to(SE2(2.0, 4.0, 0.0)) < 0.2
    with pytest.raises(BadInputError, match="not on a free cell"):
        load_world(tmp_path / "p.png", start=SE2(0.5, 0.5, 0.0))
    (tmp_path / "broken.png").write_text("no picture")
    with pytest.raises(BadInputError, match=r"broken\.png"):
        load_world(tmp_path / "broken.png")


def drawn_house() -> NDArray[np.uint8]:
    """Draw a house of four rooms, 200 x 100 pixels, in the middle of a much larger white paper."""
    pixels = np.full((300, 400), 255, np.uint8)
    cv2.rectangle(pixels, (100, 100), (300, 200), (0,), 2)
    for column in (150, 200, 250):
        cv2.line(pixels, (column, 100), (column, 135), (0,), 2)
        cv2.line(pixels, (column, 150), (column, 200), (0,), 2)
    return pixels


def test_the_start_lies_in_the_drawn_house_and_not_on_the_paper_around_it(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "house.png"), drawn_house())
    (tmp_path / "site.yaml").write_text("image: house.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    for name, resolution in (("house.png", 0.1), ("site.yaml", 0.05)):
        start = load_world(tmp_path / name).start
        assert 100 < start.x / resolution < 300
        assert 100 < start.y / resolution < 200


def test_rooms_too_small_for_a_robot_and_a_few_cells_on_the_border_do_not_move_the_start(tmp_path: Path) -> None:
    pixels = np.full((100, 100), 255, np.uint8)
    cv2.rectangle(pixels, (40, 40), (46, 46), (0,), 1)  # 0.25 m from wall to wall
    cv2.imwrite(str(tmp_path / "yard.png"), pixels)
    (tmp_path / "yard.yaml").write_text("image: yard.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    start = load_world(tmp_path / "yard.yaml").start
    assert start.distance_to(SE2(2.15, 2.85, 0.0)) > 1.0
    # A saved map, cut so closely that its floor reaches the border at one place; beside it a closed store.
    pixels = np.full((100, 100), 205, np.uint8)
    pixels[20:81, 10:61], pixels[20:81, 70:96] = 0, 0
    pixels[21:80, 11:60], pixels[40:44, 0:11], pixels[21:80, 71:95] = 254, 254, 254
    cv2.imwrite(str(tmp_path / "yard.png"), pixels)
    assert load_world(tmp_path / "yard.yaml").start.x < 3.0
    # A hall that the picture cuts, with a closet of 1 x 1 m in it.
    pixels = np.full((400, 400), 255, np.uint8)
    cv2.rectangle(pixels, (40, 40), (61, 61), (0,), 1)
    cv2.imwrite(str(tmp_path / "yard.png"), pixels)
    assert load_world(tmp_path / "yard.yaml").start.x > 3.5


def test_the_start_lies_in_the_largest_part_of_the_floor(tmp_path: Path) -> None:
    """A house of corridors around a yard of 6 x 6 m, wider than any of them, into which no door leads: only a crack of 0.2 m."""
    pixels = np.full((260, 260), 205, np.uint8)
    cv2.rectangle(pixels, (10, 10), (250, 250), (0,), 2)
    cv2.rectangle(pixels, (12, 12), (248, 248), (254,), -1)
    cv2.rectangle(pixels, (70, 70), (190, 190), (0,), 2)
    pixels[188:193, 130:134] = 254
    cv2.imwrite(str(tmp_path / "cloister.pgm"), pixels)
    (tmp_path / "cloister.yaml").write_text("image: cloister.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    start = load_world(tmp_path / "cloister.yaml").start
    assert max(abs(start.x - 6.5), abs(start.y - 6.5)) > 3.5


@pytest.mark.parametrize("origin", [0.0, -3.21, 2.347])
def test_walls_and_doors_of_a_plan_are_drawn_as_wide_as_they_are(tmp_path: Path, origin: float) -> None:
    pixels = np.full((100, 201), 254, np.uint8)
    pixels[[0, -1]], pixels[:, [0, -1]], pixels[:, 120], pixels[40:54, 120] = 0, 0, 0, 254
    cv2.imwrite(str(tmp_path / "door.pgm"), pixels)
    (tmp_path / "door.yaml").write_text(f"image: door.pgm\nresolution: 0.05\norigin: [{origin}, {origin}, 0]\n")
    _, cells = truth_grid(load_world(tmp_path / "door.yaml"), 0.18, 0.05)
    walls = np.flatnonzero((cells == OCC_OCCUPIED).sum(axis=0) > 60)
    assert len(walls) == 3
    assert np.count_nonzero(cells[:, walls[1]] == OCC_FREE) == 14


def test_only_a_block_of_grey_marks_the_start(tmp_path: Path) -> None:
    pixels = drawn_house()
    cv2.imwrite(str(tmp_path / "house.png"), pixels)
    unmarked = load_world(tmp_path / "house.png").start
    pixels[102, 110:140], pixels[102:130, 198], pixels[150, 160] = 203, 202, 204  # softened edges and a speck
    cv2.imwrite(str(tmp_path / "house.png"), pixels)
    assert load_world(tmp_path / "house.png").start == unmarked
    pixels[160:165, 265:270] = 203
    cv2.imwrite(str(tmp_path / "house.png"), pixels)
    assert load_world(tmp_path / "house.png").start == SE2(26.75, 13.75, 0.0)
    # a ring, whose middle is a column
    pixels[140:190, 255:295], pixels[144:186, 259:291], pixels[146:184, 261:289] = 203, 255, 0
    pixels[160:165, 265:270] = 0
    cv2.imwrite(str(tmp_path / "house.png"), pixels)
    assert load_world(tmp_path / "house.png").start == unmarked


def test_a_start_between_walls_of_which_every_corner_is_one_stays_in_the_middle(tmp_path: Path) -> None:
    cells = np.full((9, 30), 100, np.int8)
    cells[4, 5:25] = 0
    save_map(tmp_path / "slit", GridSpec(0.5, 30, 9, 0.0, 0.0), cells)
    assert load_world(tmp_path / "slit.yaml").start.y == pytest.approx(2.25)


@pytest.mark.parametrize("ending", ["png", "pgm", "pbm", "jpg", "bmp", "tif", "webp"])
def test_pictures_of_every_usual_kind_are_worlds(tmp_path: Path, ending: str) -> None:
    pixels = np.full((60, 80), 0, np.uint8)
    pixels[8:32, 8:72] = 255
    pixels[16:24, 56:64] = 205  # a map server's unknown is no start
    cv2.imwrite(str(tmp_path / f"p.{ending}"), pixels)
    world = load_world(tmp_path / f"p.{ending}")
    assert abs(world.start.y - 4.0) < 0.2
    assert world.solids


def test_transparent_paper_is_white(tmp_path: Path) -> None:
    pixels = drawn_house()
    cv2.imwrite(str(tmp_path / "p.png"), pixels)
    opaque = load_world(tmp_path / "p.png")
    black = np.zeros((*pixels.shape, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "p.png"), np.dstack([black, 255 - pixels]))
    assert load_world(tmp_path / "p.png") == opaque


@pytest.mark.parametrize("white", [1, 15, 100, 4095])
def test_a_picture_may_count_its_greys_up_to_any_white(tmp_path: Path, white: int) -> None:
    pixels = drawn_house()
    cv2.imwrite(str(tmp_path / "p.pgm"), pixels)
    usual = load_world(tmp_path / "p.pgm")
    values = (pixels.astype(int) // 255 * white).astype(">u2" if white > 255 else np.uint8)
    (tmp_path / "p.pgm").write_bytes(f"P5\n400 300\n{white}\n".encode() + values.tobytes())
    assert load_world(tmp_path / "p.pgm") == usual


def test_the_picture_of_a_map_is_read_with_the_yaml_beside_it(tmp_path: Path) -> None:
    cells = np.full((60, 80), 100, np.int8)
    cells[8:32, 8:72] = 0
    save_map(tmp_path / "m", GridSpec(0.05, 80, 60, -10.0, 3.0), cells)
    assert load_world(tmp_path / "m.pgm") == load_world(tmp_path / "m.yaml")
    assert load_world(tmp_path / "m.pgm").start.x < -6.0


def test_a_picture_is_read_with_the_yaml_beside_it_only_if_that_names_it(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "house.png"), drawn_house())
    plain = load_world(tmp_path / "house.png")
    (tmp_path / "house.yaml").write_text("start: {x: 1, y: 1, yaw_deg: 0}\nwalls: []\n")
    assert load_world(tmp_path / "house.png") == plain
    (tmp_path / "house.yaml").write_text("image: other.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    assert load_world(tmp_path / "house.png") == plain
    (tmp_path / "house.yaml").write_text("image: house.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    assert load_world(tmp_path / "house.png") == load_world(tmp_path / "house.yaml") != plain


def test_names_may_end_in_capitals(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "house.png"), drawn_house())
    plain = load_world(tmp_path / "house.png")
    (tmp_path / "house.png").rename(tmp_path / "house.PNG")
    assert load_world(str(tmp_path / "house.PNG")) == plain


@pytest.mark.parametrize("mode", ["raw", "scale"])
def test_floor_of_graded_maps_is_floor(tmp_path: Path, mode: str) -> None:
    occupancy = np.full((100, 100), 95, np.int8)
    occupancy[10:90, 10:90] = np.random.default_rng(1).integers(3, 30, (80, 80))
    pixels = occupancy if mode == "raw" else np.rint(255 - 2.55 * occupancy)
    cv2.imwrite(str(tmp_path / "m.png"), pixels.astype(np.uint8))
    geometry = "image: m.png\nresolution: 0.05\norigin: [0, 0, 0]\n"
    thresholds = "occupied_thresh: 0.9\nfree_thresh: 0.0\n"
    (tmp_path / "m.yaml").write_text(f"{geometry}mode: {mode}\n{thresholds}")
    world = load_world(tmp_path / "m.yaml")
    assert world.start.distance_to(SE2(2.5, 2.5, 0.0)) < 0.1
    assert load_world(tmp_path / "m.yaml", start=SE2(1.01, 1.01, 0.0)).solids == world.solids


def saved_plan(folder: Path, free_thresh: float) -> Path:
    """Save a room of 6 x 4 m as map savers do, with a gap in its wall, a cell that the beams missed, and a column whose inside nobody saw."""
    pixels = np.full((60, 120), 205, np.uint8)
    pixels[9:51, 29:91] = 0
    pixels[10:50, 30:90] = 254
    pixels[30:36, 90] = 205  # the gap
    pixels[20, 40] = 205
    pixels[18:23, 60:65], pixels[19:22, 61:64] = 0, 205
    cv2.imwrite(str(folder / "saved.pgm"), pixels)
    (folder / "saved.yaml").write_text(
        f"image: saved.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: {free_thresh}\n"
    )
    return folder / "saved.yaml"


def floor_cells(world: WorldSpec) -> float:
    """The floor that is joined to the start, in cells of 0.1 m; measured on half cells, because a true map begins with a corner at the start."""
    return np.count_nonzero(truth_grid(world, 0.25, 0.05)[1] == OCC_FREE) / 4


@pytest.mark.parametrize("free_thresh", [0.196, 0.25])
def test_a_saved_map_ends_where_its_author_saw_nothing(tmp_path: Path, free_thresh: float) -> None:
    path = saved_plan(tmp_path, free_thresh)
    world = load_world(path)
    assert floor_cells(world) == 60 * 40 - 25  # the missed cell is floor, the column is not
    assert 3.0 < world.start.x < 9.0  # the void around the room is wider
    with pytest.raises(BadInputError, match="not on a free cell"):
        load_world(path, start=SE2(1.0, 1.0, 0.0))


def test_floor_ends_with_the_picture(tmp_path: Path) -> None:
    pixels = np.full((40, 60), 255, np.uint8)
    pixels[0], pixels[-1], pixels[:, 0] = 0, 0, 0  # open on the right
    cv2.imwrite(str(tmp_path / "p.png"), pixels)
    assert floor_cells(load_world(tmp_path / "p.png")) == 38 * 59


def test_a_plan_whose_floor_is_painted_like_the_unknown_keeps_it(tmp_path: Path) -> None:
    pixels = np.full((40, 60), 0, np.uint8)
    pixels[5:35, 5:55] = 205
    cv2.imwrite(str(tmp_path / "p.png"), pixels)
    assert floor_cells(load_world(tmp_path / "p.png")) == 30 * 50


@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("name", [n for n in world_names() if load_world(n).is_flat])
def test_robots_start_free_and_can_turn_around(name: str, robot: str) -> None:
    world = load_world(name)
    collider = FootprintCollider(world, robot_named(robot))
    for k in range(36):
        assert not collider.overlapping(world.start @ SE2(0.0, 0.0, math.radians(10 * k)))


@pytest.mark.parametrize("robot", ["diff", "spot"])  # the doors are too narrow for amr_omni
def test_every_room_of_the_office_can_be_reached(robot: str) -> None:
    world = load_world("office")
    model = robot_named(robot).model
    spec, reached = reachable_cells(world, model.inscribed_radius + 0.1, 0.05, 0.5)
    for x, y in ROOMS:
        assert reached[spec.cell_of(x, y)], (x, y)


def test_office_doors_are_as_wide_as_said_and_rooms_need_them() -> None:
    """A disc of 0.40 m passes every door, one of 0.47 m none: the ten rooms and the corridor fall apart."""
    world = load_world("office")
    for radius, passes in ((0.40, True), (0.47, False)):
        spec, reached = reachable_cells(world, radius, 0.025, 0.5)
        rooms = [spec.cell_of(x, y) for x, y in ROOMS]
        assert [bool(reached[c]) for c in rooms] == [passes] * 10


def test_the_obstacle_stands_free() -> None:
    empty, obstacle = load_world("lab_empty"), load_world("lab_obstacle")
    assert len(obstacle.solids) == len(empty.solids) + 1
    _, clear = reachable_cells(obstacle, 0.6, 0.05, 0.5)
    _, count = ndimage.label(~clear)
    assert count == 2


def test_a_wall_is_cut_by_its_door(tmp_path: Path) -> None:
    path = write(tmp_path, "start: {x: 1, y: 1}\nwalls: [{from: [0, 0], to: [4, 0], doors: [{at: 2.0}]}]")
    pieces = [s for s in load_world(path).solids if s.z_min == 0.0]
    ends = sorted(float(v) for s in pieces for v in s.corners()[:, 0].round(9))
    assert ends == pytest.approx([-0.06, -0.06, 1.55, 1.55, 2.45, 2.45, 4.06, 4.06])
    (lintel,) = [s for s in load_world(path).solids if s.z_min > 0.0]
    assert (lintel.z_min, lintel.z_max, lintel.size_x) == (2.1, 2.5, pytest.approx(0.9))


def test_a_world_keeps_its_own_coordinates_and_can_be_seen_from_its_start(tmp_path: Path) -> None:
    text = (
        "start: {x: 2, y: 3, yaw_deg: 90}\nboxes: [{center: [2, 5], size: [1, 1, 1]}]\n"
        "walls: [{from: [0, 0], to: [6, 0], doors: [{at: 2.0, width: 1.2}]}]\n"
        "people: [{way: [[2, 7], [3, 7]]}]\n"
        "docks: [{name: d, pose: {x: 4, y: 3, yaw_deg: 180}, markers: [{id: 1}]}]"
    )
    world = load_world(write(tmp_path, text))
    box = next(s for s in world.solids if s.name == "box")
    assert (box.world_from_solid.x, box.world_from_solid.y) == (2.0, 5.0)
    assert world.start == SE2(2.0, 3.0, math.pi / 2)
    seen = world.from_start()
    assert seen.start.distance_to(SE2()) < 1e-12
    box = next(s for s in seen.solids if s.name == "box")
    assert (box.world_from_solid.x, box.world_from_solid.y) == pytest.approx((2.0, 0.0))
    assert seen.people[0].way[1] == pytest.approx((4.0, -1.0))
    assert seen.docks[0].world_from_dock.as_array() == pytest.approx([0.0, -2.0, math.pi / 2])
    (x, y), (u, v) = world.doors[0].slide, seen.doors[0].slide
    assert (u, v) == pytest.approx((y, -x))
    back = seen.seen_from(world.start.inverse())
    assert back.solids[0].world_from_solid.as_array() == pytest.approx(world.solids[0].world_from_solid.as_array())


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("start: {x: 0, y: 0}\nboxs: []", "boxs"),
        ("start: {x: 0, y: 0}\nwalls: [{from: [0, 0]}]", "walls.0.to"),
        ("start: {x: 0, y: 0}\nwalls: [{from: [0, 0], to: [1, 0], doors: [{at: 0.9}]}]", "walls.0.doors"),
        ("start: {x: 0, y: 0}\nwalls: [{from: [0, 0], to: [0, 0]}]", "walls.0"),
        ("start: {x: 0, y: zero}", "start.y"),
        ("start: {x: 0, y: 0}\ncylinders: [{center: [0, 0], radius: -1, height: 1}]", "cylinders.0.radius"),
        ("start: {x: 0, y: 0}\nboxes: [{center: [0, 0], size: [1, 0, 1]}]", "size"),
        ("start: {x: .nan, y: 0}", "start.x"),
        ("walls: []", "start"),
        ('start: {x: 0, y: 0}\nracks: [{corner: [0, 0], bays: "1x"}]', "racks.0.bays"),
        ("start: {x: 0, y: 0}\npeople: [{way: [[0, 0]]}]", "people.0.way"),
        ("extends: world_that_is_not\nstart: {x: 0, y: 0}", "world_that_is_not"),
        ("[1, 2]", "mapping"),
        ("start: {x: 0", "YAML"),
    ],
)
def test_mistakes_get_one_clear_line(tmp_path: Path, text: str, place: str) -> None:
    with pytest.raises(BadInputError) as caught:
        load_world(write(tmp_path, text))
    assert place in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_names_list_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="office"):
        load_world("atlantis")
    with pytest.raises(BadInputError, match="does not exist"):
        load_world(tmp_path / "none.yaml")
    with pytest.raises(BadInputError, match="diff, spot"):
        robot_named("wallee")


def test_a_world_cannot_extend_itself_in_a_circle(tmp_path: Path) -> None:
    a, b = tmp_path / "a.yaml", tmp_path / "b.yaml"
    a.write_text(f"extends: {b}\nstart: {{x: 0, y: 0}}")
    b.write_text(f"extends: {a}\nstart: {{x: 0, y: 0}}")
    with pytest.raises(BadInputError, match="extends"):
        load_world(a)


def test_merged_boxes_cover_exactly_the_occupied_cells() -> None:
    cells = np.random.default_rng(3).random((23, 31)) < 0.4
    cover = np.zeros(cells.shape, int)
    for iy0, ix0, iy1, ix1 in merge_cells(cells):
        cover[iy0:iy1, ix0:ix1] += 1
    np.testing.assert_array_equal(cover, cells.astype(int))


def test_a_floor_plan_becomes_a_world(tmp_path: Path) -> None:
    spec = GridSpec(0.1, 40, 30, -1.0, 2.0)
    plan = np.zeros(spec.shape, np.int8)
    plan[0], plan[-1], plan[:, 0], plan[:, -1], plan[10:12, 5:20] = 100, 100, 100, 100, 100
    save_map(tmp_path / "plan", spec, plan)
    world = load_world(tmp_path / "plan.yaml")
    assert len(world.solids) == 5
    start = world.start
    area = sum(s.size_x * s.size_y for s in world.solids)
    assert area == pytest.approx(np.count_nonzero(plan == 100) * 0.01)
    assert plan[spec.cell_of(start.x, start.y)] == 0
    with pytest.raises(BadInputError, match="not on a free cell"):
        load_world(tmp_path / "plan.yaml", start=SE2(-0.95, 2.05, 0.0))
