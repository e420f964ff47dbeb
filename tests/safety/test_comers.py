"""Who was seen to leave a scanner of many rings is forgotten below its lowest ring; who crouches there, and what the robot drove up to, is not."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.safety.blind_memory import BlindMemory
from tests.safety.test_blind_memory import MOUNT, PUCK, RING, SIGMA

HEIGHT = 0.8  # of the scanner
PERIOD = 0.1
Pillar = tuple[float, float, float, float]
"""x, y (odom frame), radius and height, m."""


def sweep(
    pose: SE2, pillars: list[Pillar], rng: np.random.Generator, wall: float = 3.8
) -> tuple[np.ndarray, np.ndarray]:
    """Return the returns (N, 3), base frame, within 4 m and 0.15 to 0.9 m high, of a 16-ring scanner among pillars and people in a round room, and all of them."""
    azimuth, elevation = (a.ravel() for a in np.meshgrid(np.radians(np.arange(-180, 180, 0.5)), RING, indexing="ij"))
    flat = np.full(len(azimuth), wall)
    for x, y, radius, height in pillars:
        place = pose.inverse().transform(np.array([[x, y]]))[0]
        along = np.cos(azimuth) * place[0] + np.sin(azimuth) * place[1]
        square = radius**2 - (float(place @ place) - along**2)
        reach = np.where((square > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(square, 0.0)), np.inf)
        flat = np.where((reach < flat) & (HEIGHT + reach * np.tan(elevation) < height), reach, flat)
    flat = flat + rng.normal(0.0, SIGMA, len(flat))
    z = HEIGHT + flat * np.tan(elevation)
    with np.errstate(divide="ignore"):
        to_floor = np.where(elevation < 0.0, HEIGHT / -np.tan(elevation), np.inf)
    flat, z = np.minimum(flat, to_floor), np.maximum(z, 0.0)
    is_return = (flat / np.cos(elevation) > PUCK.range_min) & (flat < 60.0)
    is_near = is_return & (z > 0.15) & (z < 0.9) & (flat < 4.0)
    points = np.column_stack((flat * np.cos(azimuth), flat * np.sin(azimuth), z))
    return points[is_near], points[is_return]


def held(scenes: list[tuple[SE2, list[Pillar]]], seed: int = 0, wall: float = 3.8) -> list[int]:
    """Return how many remembered places hold the robot in each of some scenes, 0.1 s apart."""
    memory, rng, counts = BlindMemory(0.6, 12.0), np.random.default_rng(seed), []
    for k, (pose, pillars) in enumerate(scenes):
        points, more = sweep(pose, pillars, rng, wall)
        seconds = 100.0 + PERIOD * k
        counts.append(len(memory.update(points, pose, MOUNT, PUCK, seconds=seconds, beyond=more[::7])))
    return counts


def somebody(x: float, y: float, height: float = 1.75) -> Pillar:
    return x, y, 0.25, height


def creeping(speed: float, count: int, begin: float = 0.0) -> list[SE2]:
    return [SE2(begin + speed * PERIOD * k, 0.0) for k in range(count)]


@pytest.mark.parametrize("wall", [3.8, 1000.0], ids=["in a room", "in the open"])
@pytest.mark.parametrize("ahead", [1.3, 1.6])
def test_who_walks_past_leaves_nothing_behind(ahead: float, wall: float) -> None:
    """The robot drives on to where he crossed its way: what was seen of his legs goes below its lowest ring, and no ray looks through it any more."""
    people = [[somebody(ahead + 0.5, -3.0 + 0.1 * k)] if k < 60 else [] for k in range(80)]
    runs = [held(list(zip(creeping(0.3, 80), people, strict=True)), seed, wall) for seed in range(6)]
    assert any(max(counts) > 0 for counts in runs), "his legs are below the lowest ring while he is there"
    assert [counts[-1] for counts in runs] == [0] * len(runs)


def test_who_slides_along_the_robot_and_goes_does_not_hold_it() -> None:
    scenes = [(SE2(), [somebody(3.0 - 0.1 * k, 1.2 - 0.02 * k)]) for k in range(60)] + [(SE2(), [])] * 10
    runs = [held(scenes, seed) for seed in range(4)]
    assert any(max(counts) > 0 for counts in runs)
    assert [counts[-1] for counts in runs] == [0] * len(runs)


@pytest.mark.parametrize("seconds", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("passes", [None, 0.9, 1.4], ids=["alone", "somebody passes close", "somebody passes"])
def test_who_crouches_before_the_robot_holds_it(seconds: float, passes: float | None) -> None:
    """He is below its rays a moment later, and nothing is seen of him for long."""
    comes = [somebody(4.0 - 0.1 * k, 0.0) for k in range(31)]
    steps = round(seconds / PERIOD)
    sinks = [somebody(1.0, 0.0, 1.75 - 1.35 * (k + 1) / steps) for k in range(steps)]
    scenes = [(SE2(), [p]) for p in [*comes, *sinks]]
    for k in range(150):
        pillars = [sinks[-1]]
        if passes is not None and k < 80:
            pillars.append(somebody(1.0 + passes, -4.0 + 0.1 * k))
        scenes.append((SE2(), pillars))
    assert held(scenes)[-1] > 0


def test_who_leans_where_the_scanner_sees_nothing_holds_it_though_his_companion_leaves() -> None:
    """They come up side by side; no ray meets the one who leans on the robot any more, but for his sides, and the other one is seen to go."""
    comes = [(somebody(0.1, 3.0 - 0.1 * k), somebody(0.55, max(0.8, 3.0 - 0.1 * k))) for k in range(26)]
    leans = comes[-1][0]
    leaves = [(leans, somebody(0.55 + 0.05 * k, 0.8 + 0.1 * k)) for k in range(40)]
    scenes = [(SE2(), list(people)) for people in (*comes, *[comes[-1]] * 20, *leaves, *[(leans,)] * 20)]
    counts = held(scenes)
    assert counts[-1] >= 0.8 * counts[45] > 0, "all that is remembered of his front and of his sides"


@pytest.mark.parametrize("height", [0.25, 0.4])
def test_a_box_that_the_robot_drove_up_to_holds_it_though_somebody_walks_past_it(height: float) -> None:
    """The body nods by a degree, so that the box comes into sight now and then."""
    box = (2.2, 0.0, 0.2, height)
    poses = [*creeping(0.3, 100, -1.65), *[SE2(1.35, 0.0)] * 100]
    scenes = [(pose, [box, somebody(2.9, -8.5 + 0.1 * k)] if k < 170 else [box]) for k, pose in enumerate(poses)]
    assert held(scenes)[-1] > 0


def test_a_low_thing_that_came_without_anybody_holds_the_robot_though_somebody_walks_past_it() -> None:
    cart = [(4.0 - 0.1 * min(k, 22), 0.0, 0.2, 0.45) for k in range(60)]
    poses = [*[SE2()] * 30, *creeping(0.3, 20), *[SE2(0.6, 0.0)] * 10]
    scenes = [(pose, [pillar]) for pose, pillar in zip(poses, cart, strict=True)]
    scenes += [(poses[-1], [cart[-1], somebody(4.0 - 0.1 * k, 0.48)]) for k in range(80)] + [scenes[-1]] * 10
    counts = held(scenes)
    assert counts[-1] >= counts[59] > 0


@pytest.mark.parametrize(("radius", "at"), [(0.1, (2.35, 0.25)), (0.15, (2.4, 0.2)), (0.1, (2.45, 0.0))])
@pytest.mark.parametrize("seed", range(2))
def test_a_box_holds_the_robot_though_somebody_who_stood_at_it_leaves(
    radius: float, at: tuple[float, float], seed: int
) -> None:
    """The robot waits before the box, somebody comes to it, the robot drives nearer, and he walks off."""
    box, waits, end = (2.1, 0.0, radius, 0.5), SE2(0.2, 0.0), SE2(1.0, 0.0)
    poses = [*creeping(0.3, 40, -1.0), *[waits] * 30, *creeping(0.3, 27, 0.2), *[end] * 60]
    scenes = []
    for k, pose in enumerate(poses):
        way = max(0.0, 3.0 - 0.1 * (k - 40)) if k < 97 else 0.1 * (k - 97)
        scenes.append((pose, [box, somebody(at[0] + way, at[1])] if k >= 40 else [box]))
    counts = held(scenes, seed)
    assert counts[96] > 0
    assert counts[-1] >= 0.7 * counts[96]


def test_a_tilted_scanner_tells_nobody_apart_and_neither_does_a_scan_of_time_zero() -> None:
    comes = [[somebody(4.0 - 0.1 * min(k, 30), 0.0)] for k in range(60)]
    level = MOUNT
    tilted = SE3.from_rpy(MOUNT.translation, 0.0, 0.2, 0.0)
    for mount, later, is_told in ((level, 100.0, True), (tilted, 100.0, False), (level, -6.0, False)):
        memory, rng = BlindMemory(0.6, 12.0), np.random.default_rng(0)
        for k, people in enumerate(comes):
            points, more = sweep(SE2(), people, rng)
            seconds = max(0.0, later + PERIOD * k)
            memory.update(points, SE2(), mount, PUCK, seconds=seconds, beyond=more[::7])
        assert memory._comers.came.any() == is_told


def test_nothing_is_told_of_people_without_a_time() -> None:
    memory, rng = BlindMemory(0.6, 12.0), np.random.default_rng(0)
    for k in range(60):
        points, _ = sweep(SE2(), [somebody(4.0 - 0.1 * min(k, 30), 0.0)], rng)
        memory.update(points, SE2(), MOUNT, PUCK)
        assert not memory._comers.came.any()
