"""What moves is found from scans alone, with its velocity; walls that come into sight are not taken for it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.perception.mover_tracker import MoverTracker
from ambler.registration.planar_scan import PlanarScan, RayFalls

ANGLES = np.linspace(-math.pi, math.pi, 720, endpoint=False)
RADIUS = 0.25


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


def feed(tracker: MoverTracker, k: int, discs, walls, place: SE2, rng: np.random.Generator, top: float | None = None):
    """Give the tracker one scan of 10 Hz; of a cloud if the `top` of all that it meets is told."""
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
    return tracker.update(scan, points, free, start, start)


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


def test_who_has_stood_for_ten_seconds_is_an_obstacle_until_he_walks_again() -> None:
    tracker, rng = MoverTracker(), np.random.default_rng(4)
    walk = [3.5 - 0.1 * k for k in range(12)]
    places = [*walk, *[walk[-1]] * 130, *[walk[-1] - 0.1 * k for k in range(1, 12)]]
    seen = [len(feed(tracker, k, [(x, 0.0)], ROOM, SE2(), rng)) for k, x in enumerate(places)]
    stood = len(walk)
    assert seen[stood + 80] == 1
    assert seen[stood + 110] == seen[stood + 129] == 0
    assert seen[-1] == 1
