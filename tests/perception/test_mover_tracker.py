"""What moves is found from scans alone, with its velocity; walls that come into sight are not taken for it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.perception.mover_track import NOTHING
from ambler.perception.mover_tracker import MoverTracker
from ambler.registration.planar_scan import PlanarScan, RayFalls

ANGLES = np.linspace(-math.pi, math.pi, 720, endpoint=False)
RADIUS = 0.25
NO_DRIFT = SE2()


def ranges_to(
    discs: list[tuple[float, float]], walls: list[tuple[float, float, float, float]], place: SE2
) -> np.ndarray:
    """Ranges of a perfect scanner in the world to discs and to wall segments."""
    d = np.stack((np.cos(ANGLES + place.yaw), np.sin(ANGLES + place.yaw)), axis=1)
    best = np.full(len(ANGLES), np.inf)
    for x, y in discs:
        to = np.array([x - place.x, y - place.y])
        along = d @ to
        square = RADIUS**2 - (to @ to - along**2)
        hit = (square > 0.0) & (along > 0.0)
        best[hit] = np.minimum(best[hit], along[hit] - np.sqrt(square[hit]))
    for x0, y0, x1, y1 in walls:
        ex, ey, wx, wy = x1 - x0, y1 - y0, x0 - place.x, y0 - place.y
        det = d[:, 0] * ey - d[:, 1] * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            along, across = (wx * ey - wy * ex) / det, (wx * d[:, 1] - wy * d[:, 0]) / det
        hit = (np.abs(det) > 1e-12) & (along > 0.0) & (across >= 0.0) & (across <= 1.0)
        best[hit] = np.minimum(best[hit], along[hit])
    return best


def feed(
    tracker: MoverTracker,
    k: int,
    discs,
    walls,
    place: SE2,
    rng: np.random.Generator,
    top: float | None = None,
    silent: np.ndarray = NOTHING,
    world_from_odom: SE2 = NO_DRIFT,
    map_from_odom: SE2 | None = None,
):
    """Give the tracker one scan of 10 Hz, from `place` in the world; of a cloud if the `top` of all that it meets is told. It is told in the odom
    frame, with where somebody thinks that that lies in the map."""
    ranges = ranges_to(discs, walls, place) + rng.normal(0.0, 0.01, len(ANGLES))
    is_return = np.isfinite(ranges) & (ranges < 10.0)
    directions = np.stack((np.cos(ANGLES + place.yaw), np.sin(ANGLES + place.yaw)), axis=1)
    start = np.array([[place.x, place.y]])
    points = start + ranges[is_return, None] * directions[is_return]
    free = start + 5.0 * directions[~is_return]
    scan = PlanarScan(k * 100_000_000, points.astype(np.float32), free.astype(np.float32))
    if top is not None:
        falls = np.full(len(points), 0.2, np.float32)
        scan = replace(scan, falls=RayFalls(0.8, falls, falls[: len(free)], np.full(len(points), top, np.float32)))
    told = [world_from_odom.inverse().transform(p) for p in (points, free, start, start)]
    return tracker.update(scan, *told, silent, map_from_odom)


ROOM = [(-6.0, -3.0, 6.0, -3.0), (6.0, -3.0, 6.0, 3.0), (6.0, 3.0, -6.0, 3.0), (-6.0, 3.0, -6.0, -3.0)]


@pytest.mark.parametrize(
    ("begin", "velocity"),
    [((4.5, 0.3), (-1.2, 0.0)), ((-2.0, 1.8), (1.0, 0.0)), ((1.5, -2.0), (0.0, 0.8)), ((1.0, 0.5), (0.9, 0.5))],
)
def test_a_walker_is_found_with_his_velocity(begin: tuple[float, float], velocity: tuple[float, float]) -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(3)
    for k in range(-5, 0):
        feed(tracker, k + 5, [], ROOM, SE2(), rng)
    seen = []
    for k in range(25):
        place = (begin[0] + 0.1 * k * velocity[0], begin[1] + 0.1 * k * velocity[1])
        if max(abs(place[0]) - 5.4, abs(place[1]) - 2.4) > 0.0 or math.hypot(*place) < 0.6:
            break
        movers = feed(tracker, k + 5, [place], ROOM, SE2(), rng)
        seen.append(len(movers))
        if k >= 8:
            assert len(movers) == 1
            assert math.dist(movers.states[0, :2], place) < 0.2
            assert math.dist(movers.states[0, 2:4], velocity) < 0.3
    assert 1 in seen[:8], "within 0.7 s"


def test_who_stops_stays_known_and_who_leaves_is_forgotten() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(4)
    places = [(3.0 - 0.1 * min(k, 12), 0.0) for k in range(50)]
    for k, place in enumerate(places):
        movers = feed(tracker, k, [place], ROOM, SE2(), rng)
    assert len(movers) == 1
    assert math.hypot(*movers.states[0, 2:4]) < 0.1, "he stands"
    assert movers.states[0, 4] < -0.6, "and went that way"
    for k in range(50, 62):
        movers = feed(tracker, k, [], ROOM, SE2(), rng)
    assert len(movers) == 0


def test_a_robot_that_drives_and_turns_among_walls_sees_nobody() -> None:
    walls = [*ROOM, (1.0, -3.0, 1.0, -0.6), (1.0, 0.6, 1.0, 3.0), (-2.0, 0.5, -2.0, 0.9), (3.0, 1.0, 3.4, 1.4)]
    tracker, rng, place, found = MoverTracker(), np.random.default_rng(5), SE2(-5.0, -0.1, 0.0), 0
    for k in range(150):
        found += len(feed(tracker, k, [(3.5, -1.5)], walls, place, rng))
        place = place @ SE2.exp(np.array([0.06, 0.0, 0.05 * math.sin(0.1 * k)]))
    assert found == 0


def _phantoms_of_a_round_trip(*, is_told: bool) -> int:
    walls = [*ROOM, (1.0, -3.0, 1.0, -0.6), (1.0, 0.6, 1.0, 3.0), (-2.0, 0.5, -2.0, 0.9), (3.0, 1.0, 3.4, 1.4)]
    tracker, rng, found = MoverTracker(), np.random.default_rng(15), 0
    for k in range(300):
        place = SE2(-0.5 + 3.0 * math.sin(0.02 * k), 0.1 * math.sin(0.05 * k), 0.0)
        drift = SE2(0.0, 0.0, 0.0008 * k)
        movers = feed(tracker, k, [(3.5, -1.5)], walls, place, rng, None, NOTHING, drift, drift if is_told else None)
        found += len(movers)
    return found


def test_odometry_that_drifts_makes_nobody_of_the_walls() -> None:
    """Where the robot comes back after half a minute, the odom frame has turned by 0.24 rad: what was seen free there is wall."""
    assert _phantoms_of_a_round_trip(is_told=True) == 0
    assert _phantoms_of_a_round_trip(is_told=False) > 50, "the case is none"


@pytest.mark.parametrize("correction", [SE2(-0.9, 0.4, 0.5), SE2(0.01, 0.0, 0.01)])
def test_who_is_known_stays_where_he_is_when_the_map_is_corrected(correction: SE2) -> None:
    """The robot is somewhere else in the map than it had thought. Seen from it he is where he was, and goes on as he did; nobody else came."""
    tracker, rng = MoverTracker(), np.random.default_rng(16)
    for k in range(45):
        x = 4.0 - 0.1 * max(0, k - 8)
        movers = feed(
            tracker, k, [(x, 0.5)], ROOM, SE2(), rng, None, NOTHING, NO_DRIFT, correction if k >= 22 else SE2()
        )
        if k >= 18:
            assert len(movers) == 1, f"scan {k}"
            assert known_at(movers, (x, 0.5), 0.25), f"scan {k}"
            assert math.dist(movers.states[0, 2:4], (-1.0, 0.0)) < 0.3, f"scan {k}"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("pace", [0.0, 0.04])
def test_who_is_known_in_a_doorway_stays_known_when_the_room_is_forgotten(seed: int, pace: float) -> None:
    """He comes up behind the robot, stops between the jambs, hardly two hands from one, and goes on slowly or not; he shoves the robot, so that corrections follow each other."""
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    jambs = [*ROOM, (1.0, 0.55, 1.0, 3.0), (1.0, -0.4, 1.0, -3.0)]
    for k in range(60):
        x = max(0.75, 3.0 - 0.1 * max(0, k - 5)) - pace * max(0, k - 28)
        turned = SE2(0.0, 0.0, 0.03 * sum(k >= at for at in (30, 31, 36)))
        movers = feed(tracker, k, [(x, 0.0)], jambs, SE2(), rng, None, NOTHING, NO_DRIFT, turned)
        if k >= 15 and math.hypot(x, 0.0) > 0.35:
            assert known_at(movers, (x, 0.0), 0.3), f"scan {k}"


@pytest.mark.parametrize("correction", [SE2(-0.5, 0.3, 0.0), SE2(0.0, 0.0, 0.3)])
def test_the_room_is_forgotten_when_a_correction_moves_it(correction: SE2) -> None:
    """A post that lies elsewhere in the map then, where rays had passed before, did not come."""
    tracker, rng = MoverTracker(), np.random.default_rng(17)
    for k in range(60):
        told = correction if k >= 20 else SE2()
        movers = feed(tracker, k, [(2.0, 0.6)], ROOM, SE2(), rng, None, NOTHING, NO_DRIFT, told)
        assert len(movers) == 0, f"scan {k}"


def test_the_end_of_a_wall_that_comes_into_sight_piece_by_piece_is_nobody() -> None:
    """Rays have passed where it ends; it is as wide and as bent as a person's side, but it goes on in the wall."""
    tracker, rng = MoverTracker(), np.random.default_rng(18)
    seen, whole = (2.0, -3.0, 2.0, 0.3), [(2.0, -3.0, 2.0, 0.6), (2.0, 0.6, 2.25, 0.6), (2.0, 0.45, 1.9, 0.6)]
    for k in range(40):
        walls = [*ROOM, *([seen] if k < 12 else whole)]
        assert len(feed(tracker, k, [], walls, SE2(0.0, 1.2, 0.0), rng)) == 0, f"scan {k}"


def test_who_was_there_from_the_start_is_found_when_he_comes() -> None:
    """Behind him nothing was ever seen; that makes no wall of him."""
    tracker, rng = MoverTracker(), np.random.default_rng(6)
    for k in range(22):
        movers = feed(tracker, k, [(4.0 - 0.12 * max(0, k - 6), 0.0)], ROOM, SE2(), rng)
    assert len(movers) == 1
    assert movers.states[0, 2] < -0.8


@pytest.mark.parametrize(("top", "found"), [(math.inf, True), (0.45, False)])
def test_of_a_cloud_only_what_is_tall_walks(top: float, found: bool) -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(3)
    for k in range(5):
        feed(tracker, k, [], ROOM, SE2(), rng, math.inf)
    for k in range(12):  # a chair that a scanner of many rings looks over first and meets then, piece by piece
        feed(tracker, 5 + k, [(2.0 + 0.1 * k, 0.5)], ROOM, SE2(), rng, top)
    assert bool(len(tracker.movers)) == found


def test_who_comes_so_near_that_no_ray_meets_his_head_stays_known() -> None:
    """The rays of a scanner that looks up by 15 degrees leave a person of any height below the band at half a metre."""
    tracker, rng = MoverTracker(), np.random.default_rng(8)
    for k in range(45):
        place = (max(0.75, 3.0 - 0.12 * k), 0.2)
        top = 0.8 + 0.27 * (place[0] - RADIUS)
        movers = feed(tracker, k, [place], ROOM, SE2(), rng, top if top < 0.95 else math.inf)
        if k >= 6:
            assert known_at(movers, place)


def test_who_has_stood_for_ten_seconds_is_an_obstacle_until_he_walks_again() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(4)
    walk = [3.5 - 0.1 * k for k in range(12)]
    places = [*walk, *[walk[-1]] * 130, *[walk[-1] - 0.1 * k for k in range(1, 12)]]
    seen = [len(feed(tracker, k, [(x, 0.0)], ROOM, SE2(), rng)) for k, x in enumerate(places)]
    stood = len(walk)
    assert seen[stood + 80] == 1
    assert seen[stood + 110] == seen[stood + 129] == 0
    assert seen[-1] == 1


def known_at(movers, place, within: float = 0.35) -> bool:
    """Whether somebody is known at a place."""
    return any(math.dist(state[:2], place) < within for state in movers.states)


def test_who_is_found_standing_where_the_room_was_free_may_set_out() -> None:
    """He came while the robot looked elsewhere; that nobody saw him walk does not make him a part of the room."""
    tracker, rng = MoverTracker(), np.random.default_rng(7)
    for k in range(10):
        feed(tracker, k, [], ROOM, SE2(), rng)
    for k in range(10, 24):
        movers = feed(tracker, k, [(2.0, 0.6)], ROOM, SE2(), rng)
    assert len(movers) == 1
    assert known_at(movers, (2.0, 0.6), 0.2)
    assert math.hypot(*movers.states[0, 2:4]) < 0.1


@pytest.mark.parametrize("gone", [3, 9])
def test_what_stood_there_from_the_beginning_did_not_come(gone: int) -> None:
    """Rays that graze along a wall pass it for some scans, and meet it again."""
    tracker, rng = MoverTracker(), np.random.default_rng(8)
    for k in range(60):
        is_met = k < 10 or k >= 10 + gone
        movers = feed(tracker, k, [(2.0, 0.6)] if is_met else [], ROOM, SE2(), rng)
        assert len(movers) == 0


def test_a_board_that_came_is_nobody() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(9)
    for k in range(40):
        board = [(2.0, 0.3, 2.0, 0.8)] if k >= 10 else []
        assert len(feed(tracker, k, [], [*ROOM, *board], SE2(), rng)) == 0


def test_the_corner_of_a_desk_whose_sides_were_grazed_before_they_were_met_is_nobody() -> None:
    """Rays along its sides pass through the outer half of the cells that the sides lie in; through the desk itself none ever passes."""
    tracker, rng, nothing = MoverTracker(), np.random.default_rng(14), np.zeros((0, 2))
    grazing_from, grazing_to = np.array([[2.02, 0.0], [1.5, 0.62]]), np.array([[2.02, 1.4], [3.2, 0.62]])
    for k in range(10):
        scan = PlanarScan(k * 100_000_000, nothing.astype(np.float32), grazing_to.astype(np.float32))
        tracker.update(scan, nothing, grazing_to, np.zeros((1, 2)), grazing_from)
    desk = [(2.05, 0.65, 2.05, 1.05), (2.05, 0.65, 2.45, 0.65)]
    for k in range(10, 40):
        assert len(feed(tracker, k, [], [*ROOM, *desk], SE2(), rng)) == 0


@pytest.mark.parametrize("spacing", [0.13, 0.2, 0.35])
def test_bars_that_rays_meet_now_and_then_are_nobody(spacing: float) -> None:
    """A fence of bars 2 cm wide: between two scans a ray passes where one was met, and meets the next bar."""
    bars = [(3.0, y, 3.02, y + 0.02) for y in np.arange(-2.8, 2.8, spacing)]
    bars += [(3.0, y + 0.02, 3.02, y) for y in np.arange(-2.8, 2.8, spacing)]
    tracker, rng, found = MoverTracker(), np.random.default_rng(6), 0
    for k in range(120):
        place = SE2(0.03 * min(k, 40), 0.02 * max(0, k - 60), 0.02 * math.sin(k))
        found += len(feed(tracker, k, [], [*ROOM, *bars], place, rng))
    assert found == 0


def test_two_who_walk_side_by_side_are_two() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(10)
    for k in range(25):
        x = 4.5 - 0.1 * max(0, k - 5)
        movers = feed(tracker, k, [(x, 0.3), (x, -0.3)] if k >= 5 else [], ROOM, SE2(), rng)
    assert len(movers) == 2
    assert known_at(movers, (x, 0.3))
    assert known_at(movers, (x, -0.3))


def test_two_who_meet_and_stand_before_each_other_stay_two() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(13)
    near, far = np.array([1.0, 0.0]), np.array([0.72, 0.48])
    towards = (far - near) / math.dist(near, far)
    for k in range(80):
        left = 0.1 * max(0, 30 - k)
        people = [near - left * towards, far + left * towards] if k >= 5 else []
        movers = feed(tracker, k, [tuple(p) for p in people], ROOM, SE2(), rng)
        if k >= 34:
            assert known_at(movers, near, 0.25), f"scan {k}"
            assert known_at(movers, far, 0.25), f"scan {k}"


@pytest.mark.parametrize("begin", [3.0, 2.25])
def test_who_walks_past_does_not_take_the_name_of_who_stands(begin: float) -> None:
    """He comes from afar, or out of a door beside who stands."""
    tracker, rng, stands = MoverTracker(), np.random.default_rng(11), (2.0, 0.6)
    for k in range(80):
        here = (3.2 - 0.1 * k, 0.6) if k < 12 else stands
        other = (begin - 0.1 * (k - 25), 0.12)
        movers = feed(tracker, k, [here, other] if 25 <= k < 50 else [here], ROOM, SE2(), rng)
        if k >= 14:
            assert known_at(movers, stands), f"scan {k}"
        if 35 <= k < 45:
            assert known_at(movers, other), f"scan {k}"


@pytest.mark.parametrize(("y", "gap"), [(1.3, 0.6), (0.9, 0.7)])
@pytest.mark.parametrize("seed", range(2))
def test_who_walks_up_to_another_does_not_take_his_place(y: float, gap: float, seed: int) -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    for k in range(70):
        left = 0.1 * max(0, 30 - k)
        one, other = (0.7 - 0.5 * gap - left, y), (0.7 + 0.5 * gap + 0.9 * left, y + 0.15)
        movers = feed(tracker, k, [one, other] if k >= 5 else [], ROOM, SE2(), rng)
        if k >= 20:
            assert known_at(movers, one, 0.3), f"scan {k}"
            assert known_at(movers, other, 0.3), f"scan {k}"


@pytest.mark.parametrize(
    ("stands", "stops", "course", "seed"),
    [
        ((0.9, -1.04), (0.74, -0.52), -1.82, 76),
        ((0.78, -0.81), (0.71, -0.32), -1.47, 974),
        ((1.05, 0.02), (0.66, 0.36), -0.92, 883),
    ],
)
def test_who_stops_beside_another_does_not_slide_onto_him(
    stands: tuple[float, float], stops: tuple[float, float], course: float, seed: int
) -> None:
    """He was expected to go on, and what moves of him last is the edge that is beside the other one."""
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    ahead = np.array([math.cos(course), math.sin(course)])
    for k in range(70):
        other = np.array(stops) - 0.09 * max(0, 45 - k) * ahead
        people = [(stands[0] + 0.09 * max(0, 20 - k), stands[1])] if k >= 5 else []
        movers = feed(tracker, k, [*people, tuple(other)] if k >= 15 else people, ROOM, SE2(), rng)
        if k >= 40:
            assert known_at(movers, stands, 0.3), f"scan {k}"
            assert known_at(movers, tuple(other), 0.3), f"scan {k}"


@pytest.mark.parametrize(
    ("stands", "stops", "course", "pace", "seed"),
    [
        ((-0.48, -0.97), (-0.72, -0.55), -1.54, 0.09, 5),
        ((0.2, -1.33), (-0.2, -1.08), -0.35, 0.09, 25),
        ((0.93, -0.48), (0.73, -0.02), -1.69, 0.05, 283),
        ((0.13, 1.36), (0.47, 0.95), 2.29, 0.05, 46),
    ],
)
@pytest.mark.parametrize("third", [True, False])
def test_who_stops_beside_what_stood_there_before_him_stays_where_he_is(
    stands: tuple[float, float], stops: tuple[float, float], course: float, pace: float, seed: int, third: bool
) -> None:
    """What has stood there since the first look is seen anew after some scans without it, and seems to have come; a third one stands far off, or nobody."""
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    ahead = np.array([math.cos(course), math.sin(course)])
    for k in range(70):
        other = np.array(stops) - pace * max(0, 45 - k) * ahead
        people = [] if 8 <= k < 13 else [stands]
        people += [(-2.5, 1.8 - 0.09 * max(0, 20 - k))] if third and k >= 5 else []
        movers = feed(tracker, k, [*people, tuple(other)] if k >= 15 else people, ROOM, SE2(), rng)
        if k >= 40:
            assert known_at(movers, tuple(other), 0.3), f"scan {k}"


@pytest.mark.parametrize("hidden", [5, 6])
def test_who_stops_while_somebody_hides_him_is_found_where_he_was(hidden: int) -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(20)
    for k in range(60):
        here = (2.0, -2.2 + 0.15 * min(k, 25))
        before = [(0.5 * here[0], 0.5 * here[1])] if 25 <= k < 25 + hidden else []
        movers = feed(tracker, k, [here, *before] if k >= 5 else [], ROOM, SE2(), rng)
        if k > 25 + hidden:
            assert known_at(movers, here, 0.3), f"scan {k}"


def test_who_is_hidden_behind_another_stands_there_still_until_his_place_is_seen_empty() -> None:
    tracker, rng, stands = MoverTracker(), np.random.default_rng(12), (3.0, 0.0)
    walk = [(3.0, 1.5 - 0.1 * k) for k in range(15)]
    before = [(1.5, -1.0 + 0.1 * min(k, 10)) for k in range(40)]
    k = 0
    for place in [*walk, *[stands] * 5]:
        movers = feed(tracker, k, [place], ROOM, SE2(), rng)
        k += 1
    for other in before:
        movers = feed(tracker, k, [stands, other], ROOM, SE2(), rng)
        assert known_at(movers, stands), f"scan {k}"
        k += 1
    for _ in range(14):  # the other leaves, and nobody stands behind him any more
        movers = feed(tracker, k, [], ROOM, SE2(), rng)
        k += 1
    assert not known_at(movers, stands)


@pytest.mark.parametrize("stood_there", [False, True])
def test_who_walks_to_where_no_ray_has_been_for_long_is_no_part_of_the_room(stood_there: bool) -> None:
    """He comes behind somebody who goes out of his way, and stops: where he stops nothing was known, or that somebody stood there long ago."""
    tracker, rng = MoverTracker(), np.random.default_rng(9)
    if stood_there:
        for k in range(3):
            feed(tracker, k, [(3.0, 0.0)], ROOM, SE2(), rng)
    for k in range(3, 40):
        feed(tracker, k, [(1.5, 0.0)], ROOM, SE2(), rng)
    for k in range(90):
        y = min(0.0, -1.8 + 0.11 * k)
        before = 0.0 if y < -0.5 else 0.5 * (y + 0.5) if y < 0.0 else min(2.0, 0.25 + 0.1 * (k - 17))
        movers = feed(tracker, k + 40, [(1.5, before), (3.0, y)], ROOM, SE2(), rng)
        if k >= 30:
            assert known_at(movers, (3.0, 0.0))


@pytest.mark.parametrize("walks", [True, False])
def test_who_was_seen_walking_is_somebody_for_a_minute_after_he_stopped_and_a_stranger_for_ten_seconds(
    *, walks: bool
) -> None:
    tracker, rng, stands = MoverTracker(), np.random.default_rng(3), (2.5, 0.3)
    for k in range(20):
        feed(tracker, k, [(4.0 - 0.1 * k, 0.3)] if walks and k < 15 else [], ROOM, SE2(), rng)
    rests = {}
    for k in range(20, 700):
        movers = feed(tracker, k, [stands], ROOM, SE2(), rng)
        if known_at(movers, stands):
            assert movers.rests is not None
            away = np.hypot(*(movers.states[:, :2] - stands).T)
            rests[k] = float(movers.rests[int(away.argmin())])
    last = max(rests)
    assert rests[60] == pytest.approx(4.0, abs=1.2), "he has stood since he came"
    assert (500 < last < 680) if walks else (100 < last < 160)


@pytest.mark.parametrize("seed", [2, 4])
def test_a_wall_along_which_somebody_walked_does_not_take_his_place_when_he_is_gone(seed: int) -> None:
    """Rays that graze it look through its cells, and poses are good to a centimetre: to the grid the wall comes and goes."""
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    corridor = [(-8.0, -1.1, 3.0, -1.1), (4.0, -1.1, 8.0, -1.1), (-8.0, 1.1, 8.0, 1.1), (3.0, -1.1, 3.0, -3.0)]
    walls = [*corridor, (4.0, -1.1, 4.0, -3.0)]
    for k in range(270):
        place = SE2(0.02 * min(k, 60), 0.05 * math.sin(0.11 * k), 0.02 * math.sin(0.23 * k))
        walker = (1.8 + abs((0.1 * (k - 70) + 1.8) % 6.0 - 3.0), -0.8)
        error = SE2(*rng.normal(0.0, (0.01, 0.01, 0.0025)))
        people = [walker] if 70 <= k < 250 else []
        movers = feed(tracker, k, people, walls, place, rng, None, NOTHING, NO_DRIFT, error)
    assert len(movers) == 0


def test_who_leans_on_a_robot_with_two_scanners_is_where_he_is() -> None:
    """One scanner, beside him, meets the little that it sees of him with many beams; the other sees his other side with few."""
    tracker, rng = MoverTracker(), np.random.default_rng(7)
    scanners = (SE2(0.5, 0.4, 0.0), SE2(-0.5, 0.4, 0.0))
    for k in range(60):
        person = (-0.36, 2.4 - 0.1 * min(max(k - 10, 0), 17))
        points, starts = [], []
        for scanner in scanners:
            ranges = ranges_to([person], ROOM, scanner) + rng.normal(0.0, 0.005, len(ANGLES))
            hits = np.array([scanner.x, scanner.y]) + ranges[:, None] * np.stack(
                (np.cos(ANGLES), np.sin(ANGLES)), axis=1
            )
            is_free = ~((np.abs(hits[:, 0]) < 0.5) & (np.abs(hits[:, 1]) < 0.39)) & (ANGLES > -0.1)
            points.append(hits[is_free])
            starts.append(np.tile([scanner.x, scanner.y], (int(is_free.sum()), 1)))
        hits, begins = np.concatenate(points), np.concatenate(starts)
        scan = PlanarScan(k * 100_000_000, hits.astype(np.float32), np.zeros((0, 2), np.float32))
        movers = tracker.update(scan, hits, np.zeros((0, 2)), begins, np.zeros((1, 2)))
    by_hand = np.hypot(*(hits - person).T) < 0.3
    assert math.dist(hits[by_hand].mean(axis=0), person) > 0.15, "where most beams meet him is not where he is"
    assert len(movers) == 1
    assert math.dist(movers.states[0, :2], person) < 0.07
