"""Glass from light and sound: peaks are found where a pane is met squarely, lines grow with motion, and what passes disproves them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import JudgedEcho, LaserScan, Range
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.echoes import EchoFilter
from ambler.perception.glass import SpecularDetector
from ambler.perception.glass_map import GlassMap, seen_through_glass
from ambler.perception.near_panes import spread

SIGMA = math.radians(2.5)
HALF = math.radians(15.0)
NONE = np.empty((0, 2))


def scan(
    pose: SE2, pane: float | None = 2.0, pane_ends: tuple[float, float] = (-3.0, 3.0), noise: float = 0.0, seed: int = 0
) -> LaserScan:
    """A room of 12 m with its walls at x = ±6, y = ±6, and a pane at x = `pane`, as a scanner at `pose` sees them."""
    rng = np.random.default_rng(seed)
    angles = -math.pi + np.arange(720) * math.radians(0.5)
    c, s = np.cos(angles + pose.yaw), np.sin(angles + pose.yaw)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (np.sign(c) * 6 - pose.x) / c, (np.sign(s) * 6 - pose.y) / s
        ranges = np.minimum(x, y)
        intensity = 0.6 * np.where(x < y, np.abs(c), np.abs(s))
        if pane is not None:
            t = (pane - pose.x) / c
            hit = (
                (t > 0)
                & (np.abs(c) > math.cos(math.radians(12)))
                & (pane_ends[0] < pose.y + t * s)
                & (pose.y + t * s < pane_ends[1])
            )
            ranges = np.where(hit, t, ranges)
            intensity = np.where(
                hit, 0.06 + 4 * np.exp(-0.5 * (np.arccos(np.minimum(1, np.abs(c))) / SIGMA) ** 2), intensity
            )
    ranges = ranges + noise * rng.standard_normal(720)
    return LaserScan(
        0,
        "laser",
        -math.pi,
        math.radians(0.5),
        0.0,
        0.1,
        0.1,
        20.0,
        ranges.astype(np.float32),
        intensity.astype(np.float32),
    )


def test_retro_reflectors_are_no_glass() -> None:
    """Film on a thing before a far wall has the form of a peak; nothing but its brightness tells it from a pane."""
    glass = scan(SE2(), pane_ends=(-0.3, 0.3))
    assert len(SpecularDetector().detect(glass)) == 1
    film = replace(glass, intensities=np.where(glass.intensities > 1.0, np.float32(500.0), glass.intensities))
    assert SpecularDetector().detect(film) == ()


def test_intensities_of_another_unit_show_no_glass() -> None:
    """A scanner that counts to 255 calls every painted wall brighter than white paint."""
    glass = scan(SE2(), pane_ends=(-0.3, 0.3))
    for unit in (3.0, 20.0, 200.0):
        other = replace(glass, intensities=(unit * np.maximum(glass.intensities, 0.55)).astype(np.float32))
        assert SpecularDetector().detect(other) == ()


def test_in_the_open_a_few_returns_of_another_unit_show_no_glass() -> None:
    """Nine of ten beams meet nothing, and 255 is the brightest that the scanner tells: black things lie where panes do."""
    glass = scan(SE2(), pane_ends=(-0.3, 0.3))
    is_far = glass.ranges > 3.0
    is_far[np.flatnonzero(is_far)[::15]] = False
    ranges = np.where(is_far, np.inf, glass.ranges).astype(np.float32)
    near = replace(glass, ranges=ranges)
    detector = SpecularDetector()
    assert len(detector.detect(near)) == 1
    dark = np.where(glass.ranges > 3.0, 100.0, 3.0 * glass.intensities).astype(np.float32)
    assert SpecularDetector().detect(replace(near, intensities=dark)) == ()


def test_a_glance_at_nothing_but_a_pane_does_not_change_the_unit() -> None:
    glass = scan(SE2(), pane_ends=(-0.3, 0.3))
    shines = glass.intensities > 1.0
    alone = replace(glass, ranges=np.where(shines | (glass.ranges > 3.0), glass.ranges, np.nan).astype(np.float32))
    alone = replace(alone, ranges=np.where(glass.ranges > 3.0, np.inf, alone.ranges).astype(np.float32))
    detector = SpecularDetector()
    detector.detect(glass)
    for _ in range(20):
        assert len(detector.detect(alone)) == 1


@pytest.mark.parametrize("yaw_deg", [0.0, 37.3, 179.9, -100.0])
def test_a_pane_goes_on_to_its_posts(yaw_deg: float) -> None:
    pose = SE2(1.2, 0.0, math.radians(yaw_deg))
    bare = scan(pose)
    angles = -math.pi + np.arange(720) * math.radians(0.5) + pose.yaw
    with np.errstate(divide="ignore"):
        y = np.where(np.cos(angles) > 0.1, 0.8 * np.tan(angles), np.inf)
    is_post = (np.abs(y - 0.5) < 0.05) | (np.abs(y + 0.9) < 0.05)
    posted = replace(bare, ranges=np.where(is_post, 0.8 / np.cos(angles), bare.ranges).astype(np.float32))
    for seen, ends in ((bare, (-0.7, 0.7)), (posted, (-0.7, 0.45))):
        (peak,) = SpecularDetector().detect(seen)
        points = pose.transform(spread(seen, peak, 0.7, 0.04))
        np.testing.assert_allclose(points[:, 0], 2.0, atol=0.01)
        assert points[:, 1].min() == pytest.approx(ends[0], abs=0.03)
        assert points[:, 1].max() == pytest.approx(ends[1], abs=0.03)
        assert np.diff(np.sort(points[:, 1])).max() < 0.05


@pytest.mark.parametrize("yaw_deg", [0.0, 0.2, 37.3, 179.9])
@pytest.mark.parametrize("x", [-2.0, 0.0, 1.5])
def test_a_pane_shows_its_normal_and_its_distance(x: float, yaw_deg: float) -> None:
    pose = SE2(x, 0.5, math.radians(yaw_deg))
    (peak,) = SpecularDetector().detect(scan(pose, noise=0.01, seed=3))
    assert peak.distance == pytest.approx(2.0 - x, abs=0.01)
    assert abs(math.remainder(peak.angle + pose.yaw, 2 * math.pi)) < math.radians(0.3)
    reach = (2.0 - x) * math.tan(math.radians(12))
    assert peak.left == pytest.approx(reach, abs=0.06)
    assert peak.right == pytest.approx(reach, abs=0.06)


def test_a_wall_a_bright_wall_and_a_bright_post_are_no_glass() -> None:
    detector = SpecularDetector()
    assert detector.detect(scan(SE2(), None)) == ()
    plain = scan(SE2(), None)
    mirror = replace(plain, intensities=np.where(np.abs(np.arange(720) - 360) < 8, 4.0, 0.5).astype(np.float32))
    assert detector.detect(mirror) == (), "something shiny, but nothing passes beside it"
    assert detector.detect(replace(plain, intensities=np.empty(0, np.float32))) == ()


def test_a_scan_without_panes_keeps_everything_else() -> None:
    seen = scan(SE2(0.0, 0.5, 0.4), noise=0.01)
    left = SpecularDetector().without_panes(seen)
    lost = np.isnan(left.ranges)
    bare = scan(SE2(0.0, 0.5, 0.4), None)
    on_pane = seen.ranges < bare.ranges - 0.5
    assert np.count_nonzero(on_pane) == pytest.approx(48, abs=3)
    assert np.array_equal(lost, on_pane)
    assert SpecularDetector().without_panes(bare) is bare


def test_lost_beams_do_not_hide_a_pane() -> None:
    seen = scan(SE2(), noise=0.01)
    ranges = seen.ranges.copy()
    ranges[np.random.default_rng(1).random(720) < 0.2] = np.nan
    assert len(SpecularDetector().detect(replace(seen, ranges=ranges))) == 1


def watched(poses: list[SE2], **changes: object) -> GlassMap:
    glass, detector = GlassMap(), SpecularDetector()
    for k, pose in enumerate(poses):
        seen = scan(pose, noise=0.01, seed=k, **changes)  # type: ignore[arg-type]
        glass.add_scan(seen, pose, np.zeros(3))
        for peak in detector.detect(seen):
            glass.add_peak(peak, pose)
    return glass


def along(y0: float, y1: float, x: float = 0.0) -> list[SE2]:
    return [SE2(x, y, math.radians(30 + 20 * y)) for y in np.arange(y0, y1, 0.08)]


def test_driving_along_a_pane_draws_all_of_it() -> None:
    segments, confidence = watched(along(-2.8, 2.8)).segments()
    assert len(segments) == 1
    x0, y0, x1, y1 = segments[0]
    np.testing.assert_allclose([x0, x1], 2.0, atol=0.02)
    np.testing.assert_allclose(sorted((y0, y1)), (-3.0, 3.0), atol=0.2)
    assert confidence[0] > 0.9


def test_a_door_in_the_pane_stays_open() -> None:
    glass, detector = GlassMap(), SpecularDetector()
    for k, pose in enumerate(along(-2.8, 2.8, 0.8)):
        ends = (-3.0, -0.6) if pose.y < 0 else (0.6, 3.0)
        seen = scan(pose, pane_ends=ends, noise=0.01, seed=k)
        glass.add_scan(seen, pose, np.zeros(3))
        for peak in detector.detect(seen):
            glass.add_peak(peak, pose)
    segments, _ = glass.segments()
    assert len(segments) == 2
    covered = [sorted((s[1], s[3])) for s in segments]
    for low, high in covered:
        assert high < -0.4 or low > 0.4, "the opening of 1.2 m is not called glass"


def test_a_pane_that_is_gone_is_disproved() -> None:
    glass = watched(along(-1.0, 1.0))
    assert len(glass.segments()[0]) == 1
    for _ in range(3):
        for pose in along(-1.6, 1.6):
            glass.add_scan(scan(pose, None), pose, np.zeros(3))
    assert len(glass.segments()[0]) == 0


def test_the_same_drive_gives_the_same_glass() -> None:
    first, second = (watched(along(-1.0, 1.0)).segments() for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def echo(distance: float, *, unexplained: bool = True) -> JudgedEcho:
    return JudgedEcho(0, "odom", "sonar_0", SE3(), HALF, distance, min(distance, 3.0), unexplained)


def test_sound_extends_a_pane_that_light_has_found_and_free_cones_shorten_it() -> None:
    glass = watched([SE2(0.0, 0.0, 0.0)] * 3)
    (before,) = glass.segments()[0]
    length = abs(before[3] - before[1])
    for y in np.arange(0.0, 2.0, 0.08):
        for _ in range(2):
            glass.add_echo(echo(1.8), SE2(0.2, y, 0.0))
    (after,) = glass.segments()[0]
    assert max(after[1], after[3]) == pytest.approx(2.0, abs=0.15)
    assert abs(after[3] - after[1]) > length + 1.0
    for y in np.arange(1.0, 2.2, 0.05):
        for _ in range(8):
            glass.add_echo(echo(math.inf, unexplained=False), SE2(0.5, y, 0.0))
    (last,) = glass.segments()[0]
    assert max(last[1], last[3]) < 1.1
    alone = GlassMap()
    alone.add_echo(echo(1.8), SE2(0.2, 0.0, 0.0))
    assert len(alone.segments()[0]) == 0, "sound alone draws no line: it does not know where on its arc"


def test_what_was_seen_through_glass_is_told_apart_from_what_can_be_reached() -> None:
    spec = GridSpec(0.05, 80, 40, -1.0, -1.0)
    occupancy = np.zeros(spec.shape, np.int8)
    occupancy[0, :] = occupancy[-1, :] = occupancy[:, 0] = occupancy[:, -1] = 100
    pane = np.array([[1.02, -1.0, 1.02, 1.0]], np.float32)
    mask = seen_through_glass(spec, occupancy, pane)
    xy = spec.centers_of(np.argwhere(mask))
    assert xy[:, 0].min() > 1.0
    assert np.count_nonzero(mask) == pytest.approx(38 * 38, abs=100)
    gap = np.array([[1.02, -1.0, 1.02, 0.5]], np.float32)
    assert seen_through_glass(spec, occupancy, gap).any(), "no way for a robot"
    short = np.array([[1.02, -1.0, 1.02, -0.1]], np.float32)
    assert not seen_through_glass(spec, occupancy, short).any(), "around the pane there is a way"
    assert not seen_through_glass(spec, occupancy, np.zeros((0, 4), np.float32)).any()


ROBOT = RobotModel(
    "toy",
    DriveKind.OMNI,
    np.array([[0.2, -0.2], [0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2]]),
    VelocityLimits(),
    (SensorMount("sonar_0", SensorKind.RANGE, SE3((0.2, 0.0, 0.2)), 0.03),),
)


def measured(stamp: float, distance: float) -> Range:
    return Range(round(stamp * 1e9), "sonar_0", 2 * HALF, 0.03, 3.0, distance)


def test_an_echo_counts_when_a_second_agrees_and_no_light_explains_it() -> None:
    judge = EchoFilter(ROBOT)
    assert judge.update(measured(0.0, 1.0), SE2(), [NONE]) is None
    second = judge.update(measured(0.08, 1.02), SE2(), [NONE])
    assert second is not None
    assert second.is_unexplained
    assert second.free == pytest.approx(1.02)
    arc = second.arc(0.04)
    np.testing.assert_allclose(np.hypot(arc[:, 0] - 0.2, arc[:, 1]), 1.02, rtol=1e-6)
    assert np.abs(np.diff(arc, axis=0)).max() < 0.05
    behind_glass = np.array([[3.2, 0.0], [1.2, 1.0], [0.4, 0.0]])
    assert judge.update(measured(0.16, 1.0), SE2(), [behind_glass]).is_unexplained  # type: ignore[union-attr]
    post = np.array([[1.17, 0.22]])
    explained = judge.update(measured(0.24, 1.0), SE2(), [behind_glass, post])
    assert explained is not None
    assert not explained.is_unexplained


def test_crosstalk_a_lost_echo_and_no_measurement_do_not_matter() -> None:
    judge = EchoFilter(ROBOT)
    for k in range(3):
        judge.update(measured(0.08 * k, 1.0), SE2(), [NONE])
    assert judge.update(measured(0.24, 0.4), SE2(), [NONE]) is None, "crosstalk"
    assert judge.update(measured(0.32, 1.0), SE2(), [NONE]) is not None
    assert judge.update(measured(0.40, math.inf), SE2(), [NONE]) is None, "a lost echo"
    assert judge.update(measured(0.48, 1.0), SE2(), [NONE]) is not None
    assert judge.update(measured(0.56, math.nan), SE2(), [NONE]) is None
    judge.update(measured(0.64, math.inf), SE2(), [NONE])
    nothing = judge.update(measured(0.72, math.inf), SE2(), [NONE])
    assert nothing is not None
    assert (nothing.distance, nothing.free, nothing.is_unexplained) == (math.inf, 3.0, False)
    judge.update(measured(0.80, -math.inf), SE2(), [NONE])
    touching = judge.update(measured(0.88, -math.inf), SE2(), [NONE])
    assert touching is not None
    assert touching.distance == pytest.approx(0.03)
    assert judge.update(measured(2.0, 1.0), SE2(), [NONE]) is None, "too long ago to confirm anything"


def test_an_echo_that_never_stops_jumping_counts_all_the_same() -> None:
    judge = EchoFilter(ROBOT)
    said = [judge.update(measured(0.08 * k, 0.5 + 0.4 * (k % 4)), SE2(), [NONE]) for k in range(9)]
    assert said[:2] == [None, None]
    assert all(e is not None and e.is_unexplained for e in said[2:])


def test_the_robots_own_motion_is_no_disagreement() -> None:
    judge = EchoFilter(ROBOT)
    for k in range(5):
        last = judge.update(measured(0.08 * k, 2.0 - 0.15 * k), SE2(0.15 * k, 0.0, 0.0), [NONE])
    assert last is not None
    assert last.is_unexplained


def test_simulated_glass_is_found_by_the_simulated_scanner() -> None:
    from ambler.sim.robots import robot_named
    from ambler.sim.simulation import Simulation, SimulationConfig
    from ambler.sim.solids import Shape, Solid, WorldSpec

    pane = Solid("pane", Shape.BOX, SE2(2.0, 0.0, 0.0), 0.02, 3.0, 0.0, 2.0, is_glass=True)
    wall = Solid("wall", Shape.BOX, SE2(4.25, 0.0, 0.0), 0.5, 40.0, 0.0, 2.0)
    simulation = Simulation(
        WorldSpec("w", (pane, wall), SE2()), robot_named("diff"), SimulationConfig(1, physics="kinematic")
    )
    found = 0
    for _ in range(10):
        simulation.command(BodyVelocity(0.0, 0.0, 0.3))
        for seen in simulation.step(simulation.now_ns + 100_000_000).scans:
            found += len(SpecularDetector().detect(seen))
    assert found >= 8
