"""What a scanner cannot see any more stays an obstacle: until it is seen again, looked through, or too far back to trust."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import looks
from ambler.robots.catalog import robot_model
from ambler.safety.blind_memory import BlindMemory, see_all_around
from ambler.safety.field_of_view import FieldOfView
from ambler.safety.points import patch_means
from ambler.safety.visitors import rim_of

MOUNT = SE3((0.0, 0.0, 0.8))
PUCK = FieldOfView(0.4, elevation=(-math.radians(15), math.radians(15)))
RING = np.radians(np.arange(-15, 16, 2))
SIGMA = 0.012


def spin(pose: SE2, wall_y: float, rng: np.random.Generator, box: tuple[float, float] | None = None) -> np.ndarray:
    """Return the returns (N, 3), base frame, of a 16-ring scanner beside a wall along y = `wall_y` of the odom frame, and before
    a low box (x, height) if given; all 0.15 to 0.9 m high."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-180, 180, 0.5)), RING, indexing="ij")
    azimuth, elevation = azimuth.ravel(), elevation.ravel()
    heading = azimuth + pose.yaw
    with np.errstate(divide="ignore"):
        flat = np.where(np.sin(heading) > 1e-3, (wall_y - pose.y) / np.sin(heading), np.inf)
        if box is not None:
            to_box = np.where(np.cos(heading) > 1e-3, (box[0] - pose.x) / np.cos(heading), np.inf)
            height = 0.8 + to_box * np.tan(elevation)
            hits_box = (to_box > 0) & (height < box[1]) & (np.abs(to_box * np.sin(heading)) < 0.4)
            flat = np.where(hits_box, np.minimum(flat, to_box), flat)
    ranges = flat / np.cos(elevation) + rng.normal(0.0, SIGMA, len(flat))
    z = 0.8 + flat * np.tan(elevation)
    is_return = np.isfinite(ranges) & (ranges > PUCK.range_min) & (ranges < 8.0) & (z > 0.15) & (z < 0.9)
    r, a, e = ranges[is_return], azimuth[is_return], elevation[is_return]
    return np.stack((r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), 0.8 + r * np.sin(e)), axis=1)


def test_a_wall_that_comes_too_near_stays_where_it_was() -> None:
    memory, rng = BlindMemory(0.6, 4.0), np.random.default_rng(1)
    for y in np.arange(0.0, 0.7001, 0.02):  # sideways towards the wall at y = 1
        pose = SE2(0.0, float(y))
        kept = memory.update(spin(pose, 1.0, rng), pose, MOUNT, PUCK)
    beside = kept[np.abs(kept[:, 0]) < 0.2]
    assert len(beside) >= 8, "the blind stretch of the wall is 0.4 m long at a distance of 0.3 m"
    assert np.abs(beside[:, 1] - 0.3).max() < 0.03
    assert abs(float(np.median(beside[:, 1])) - 0.3) < 0.008
    for _ in range(50):  # standing still makes nothing thicker, and nothing is forgotten
        kept = memory.update(spin(pose, 1.0, rng), pose, MOUNT, PUCK)
    again = kept[np.abs(kept[:, 0]) < 0.2]
    assert len(again) >= 8
    assert np.abs(again[:, 1] - 0.3).max() < 0.03


def test_what_is_seen_again_is_left_to_the_scan() -> None:
    memory, rng = BlindMemory(0.6, 4.0), np.random.default_rng(2)
    for y in [*np.arange(0.0, 0.7001, 0.02), *np.arange(0.7, -0.001, -0.02)]:
        pose = SE2(0.0, float(y))
        kept = memory.update(spin(pose, 1.0, rng), pose, MOUNT, PUCK)
    near = kept[(np.abs(kept[:, 0]) < 0.5) & (np.abs(kept[:, 1] - 1.0) < 0.1)]
    assert len(near) == 0


def test_a_low_box_below_the_lowest_ring_is_not_forgotten() -> None:
    memory, rng = BlindMemory(0.6, 4.0), np.random.default_rng(3)
    for x in np.arange(0.0, 2.4001, 0.05):  # the box is 0.3 m high: unseen from nearer than 1.87 m
        pose = SE2(float(x), 0.0)
        points = spin(pose, 5.0, rng, box=(3.0, 0.3))
        kept = memory.update(points, pose, MOUNT, PUCK)
    assert not np.any((np.abs(points[:, 0] - 0.6) < 0.1) & (np.abs(points[:, 1]) < 0.3)), (
        "the scan itself is blind there"
    )
    box = kept[(np.abs(kept[:, 0] - 0.6) < 0.08) & (np.abs(kept[:, 1]) < 0.35)]
    assert len(box) >= 5


def test_returns_behind_a_remembered_point_prove_it_gone() -> None:
    memory = BlindMemory(0.3, 4.0)
    field = FieldOfView(0.4)
    angles = np.radians(np.arange(-20.0, 20.0, 0.25))
    person = np.stack((0.5 * np.cos(angles), 0.5 * np.sin(angles), np.full(len(angles), 0.8)), axis=1)
    assert len(memory.update(person, SE2(), MOUNT, field)) == 0
    nothing = np.empty((0, 3))
    near = SE2(0.2, 0.0)
    assert len(memory.update(nothing, near, MOUNT, field)) > 0, "nothing seen proves nothing"
    angles = np.radians(np.arange(-180.0, 180.0, 0.25))
    room = np.stack((4.0 * np.cos(angles), 4.0 * np.sin(angles), np.full(len(angles), 0.8)), axis=1)
    assert len(memory.update(room, near, MOUNT, field)) == 0


@pytest.mark.parametrize("radius", [0.015, 0.02, 0.03])
@pytest.mark.parametrize("shift", [0.0, 0.01, 0.02, 0.03])  # in the columns of the memory
def test_a_beam_past_the_edge_of_a_thin_post_does_not_prove_it_gone(radius: float, shift: float) -> None:
    memory, field, rng = BlindMemory(0.3, 4.0), FieldOfView(0.4), np.random.default_rng(0)
    angles = np.radians(np.arange(-180.0, 180.0, 0.2))
    post = np.array([shift, 0.3])
    for x in [*np.arange(-1.0, 0.01, 0.02), *[0.0] * 50]:  # past it, and it stands beside it
        dx, dy = post - (x, 0.0)
        along, beside = dx * np.cos(angles) + dy * np.sin(angles), np.abs(dx * np.sin(angles) - dy * np.cos(angles))
        is_met = (beside < radius) & (along > 0.0)
        ranges = np.where(is_met, along - np.sqrt(np.maximum(radius**2 - beside**2, 0.0)), 4.0)
        ranges += rng.normal(0.0, 0.005, len(ranges))
        room = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.full(len(angles), 0.8)))
        kept = memory.update(room[ranges >= field.range_min], SE2(float(x), 0.0), MOUNT, field)
    assert len(kept) > 0
    room = np.column_stack((4.0 * np.cos(angles), 4.0 * np.sin(angles), np.full(len(angles), 0.8)))
    assert len(memory.update(room, SE2(), MOUNT, field)) == 0, "it was taken away"


def test_a_sector_scanner_is_blind_beside_its_sector() -> None:
    memory = BlindMemory(0.3, 10.0)
    field = FieldOfView(0.05, azimuth=(-math.radians(135), math.radians(135)))
    pole = np.column_stack((np.full(20, 1.0), np.linspace(-0.02, 0.02, 20), np.full(20, 0.8)))
    memory.update(pole, SE2(), MOUNT, field)
    for yaw in np.radians(np.arange(0.0, 180.1, 4.0)):
        pose = SE2(0.0, 0.0, float(yaw))
        seen = np.column_stack((pose.inverse().transform(pole[:, :2]), pole[:, 2]))
        in_sector = np.abs(np.arctan2(seen[:, 1], seen[:, 0])) < field.azimuth[1]
        kept = memory.update(seen[in_sector], pose, MOUNT, field)
    assert len(kept) >= 1
    assert kept[0, :2] == pytest.approx((-1.0, 0.0), abs=0.05)


def test_odometry_is_trusted_for_some_metres_only() -> None:
    memory = BlindMemory(0.6, 4.0)
    pole = np.array([[0.42, 0.3, 0.8]] * 4)
    memory.update(pole, SE2(), MOUNT, PUCK)
    nothing = np.empty((0, 3))
    assert len(memory.update(nothing, SE2(0.3, 0.0), MOUNT, PUCK)) == 1
    for yaw in np.arange(0.1, 2 * math.pi + 0.2, 0.1):
        kept = memory.update(nothing, SE2(0.3, 0.0, float(yaw)), MOUNT, PUCK)
    assert len(kept) == 0, "a full turn moves the outermost corner by 3.8 m"


def test_what_is_hidden_keeps_its_height_while_the_robot_climbs() -> None:
    memory = BlindMemory(0.6, 4.0)
    pole = np.tile([0.45, 0.0, 0.8], (5, 1))
    memory.update(pole, SE2(), MOUNT, PUCK, height=1.0)
    kept = memory.update(np.empty((0, 3)), SE2(0.3, 0.0), MOUNT, PUCK, height=1.1)
    assert kept == pytest.approx(np.array([[0.15, 0.0, 0.7]]))


def test_a_scanner_that_counts_from_zero_to_a_full_turn_sees_all_around() -> None:
    field = FieldOfView(0.1, azimuth=(0.0, 2.0 * math.pi)).shrunk(0.1, 0.0)
    azimuth = np.radians(np.array([-179.0, -90.0, 0.5, 90.0, 179.0]))
    assert field.contains((np.full(5, 2.0), azimuth, np.zeros(5))).all()


@pytest.mark.parametrize("spacing_deg", [0.2, 0.4, 0.6, 1.0])
def test_a_low_box_seen_by_one_ring_remains_an_obstacle(spacing_deg: float) -> None:
    azimuth = np.radians(np.arange(-10.0, 10.0, spacing_deg))
    box = np.stack((1.2 * np.ones(len(azimuth)), 1.2 * np.tan(azimuth), np.full(len(azimuth), 0.3)), axis=1)
    assert len(patch_means(box, (0.0, 0.0))) >= 2


def test_patches_end_the_bias_of_the_nearest_of_many_returns() -> None:
    rng = np.random.default_rng(5)
    azimuth, ring = np.meshgrid(np.radians(np.arange(-40.0, 40.0, 0.2)), np.arange(8), indexing="ij")
    ranges = 0.6 / np.cos(azimuth.ravel()) + rng.normal(0.0, SIGMA, azimuth.size)
    z = 0.3 + 0.05 * ring.ravel()
    wall = np.stack((ranges * np.cos(azimuth.ravel()), ranges * np.sin(azimuth.ravel()), z), axis=1)
    assert np.sort(wall[:, 0])[1] < 0.6 - 2.8 * SIGMA
    nearest = np.sort(patch_means(wall, (0.0, 0.0))[:, 0])[1]
    assert 0.6 - 2.2 * SIGMA < nearest < 0.6


def test_only_a_planar_scanner_all_around_whose_blind_zone_is_within_the_robot_needs_no_memory() -> None:
    inside = 0.16  # metres from the scanner to the nearest edge of the footprint
    assert FieldOfView(0.1).has_all_beyond(inside)
    assert not FieldOfView(0.15).has_all_beyond(inside)
    assert not FieldOfView(0.1, azimuth=(-2.3, 2.3)).has_all_beyond(inside)
    assert not PUCK.has_all_beyond(5.0), "below and above its rays it sees nothing at any distance"


SIDE = FieldOfView(0.05, (math.radians(-130.0), math.radians(130.0)))
CORNER = SE3.from_rpy((0.6, -0.4, 0.2), 0.0, 0.0, math.radians(-45.0))


def around_corner(person: tuple[float, float] | None, pose: SE2 | None = None, radius: float = 0.25) -> np.ndarray:
    """Returns (N, 3), base frame, of a planar scanner on the front right corner, which does not see along the robot's side: a far wall along
    y = -4 of the odom frame, and a person, or a post of another `radius`, there (odom frame)."""
    pose = SE2() if pose is None else pose
    eye = pose.transform(np.array([[0.6, -0.4]]))[0]
    bearings = np.radians(np.arange(-130.0, 130.0, 0.5)) + math.radians(-45.0) + pose.yaw
    rows = []
    for bearing in bearings:
        ahead = np.array([math.cos(bearing), math.sin(bearing)])
        reach = (-4.0 - eye[1]) / ahead[1] if ahead[1] < -1e-3 else math.inf
        if person is not None:
            to = np.array(person) - eye
            along, beside = float(to @ ahead), float(abs(to[0] * ahead[1] - to[1] * ahead[0]))
            if beside < radius and along > 0.0:
                reach = min(reach, along - math.sqrt(radius**2 - beside**2))
        if SIDE.range_min < reach < 8.0:
            rows.append((*(eye + reach * ahead), 0.2))
    points = np.array(rows)
    points[:, :2] = pose.inverse().transform(points[:, :2])
    return points


def test_who_walks_up_to_a_standing_robot_and_away_again_does_not_hold_it_for_ever() -> None:
    memory, now, most = BlindMemory(0.72, 12.0), 0.0, 0
    comes = [None] * 20 + [(-0.1, -2.0 + 0.06 * k) for k in range(23)] + [(-0.1, -0.66)] * 20
    leaves = [(-0.1, -0.7 - 0.06 * k) for k in range(40)] + [None] * 60
    shifted = SE2(0.0, -0.04)  # towards him, who gives way: what was at the rim of the sector is beside it now
    for place, pose in [*((p, SE2()) for p in comes), *((p, shifted) for p in leaves)]:
        now += 0.05
        kept = memory.update(around_corner(place, pose), pose, CORNER, SIDE, (), now)
        most = max(most, len(kept))
    assert most > 0, "his near side lies beside the sector"
    assert len(kept) == 0


def test_what_a_robot_drove_up_to_is_held_however_long_nothing_is_seen_of_it() -> None:
    memory, now = BlindMemory(0.72, 12.0), 0.0
    post = (0.4, -0.43)
    poses = [SE2(float(x), 0.0) for x in [*[-9.0] * 20, *np.arange(-9.0, -1.5, 0.1), *np.arange(-1.5, 0.5, 0.04)]]
    for pose in [*poses, *[poses[-1]] * 200]:  # it stood where it did not see the post yet
        now += 0.05
        kept = memory.update(around_corner(post, pose, 0.02), pose, CORNER, SIDE, (), now)
    assert len(kept) > 0


def test_only_a_robot_that_looks_all_around_may_forget_visitors() -> None:
    robot = robot_model("amr_omni")
    rim = rim_of(robot.footprint)
    planar = [(m.base_from_sensor, FieldOfView(0.05, m.azimuth)) for m in robot.scanners]
    assert see_all_around(rim, planar)
    front_right, front_left, rear_left = planar
    assert see_all_around(rim, [front_right, rear_left]), "two at opposite corners"
    for left in ([front_right, front_left], [front_left, rear_left], [front_right]):
        assert not see_all_around(rim, left), "anybody may stand where nothing looks"
    assert not see_all_around(rim, [(SE3((0.0, 0.0, 0.5)), PUCK)]), "below the lowest ring somebody may crouch"


def walk(memory: BlindMemory, people: list, poses: list[SE2]) -> tuple[int, int]:
    """Feed scans at 20 Hz with a person (or None) and the robot's pose in each; return how many places were held at most, and at the end."""
    now, held = 0.0, [0]
    for person, pose in zip(people, poses, strict=True):
        now += 0.05
        held.append(len(memory.update(around_corner(person, pose), pose, CORNER, SIDE, (), now)))
    return max(held), held[-1]


def test_who_touches_a_moving_robot_and_leaves_does_not_hold_it_either() -> None:
    """It creeps when he comes up to its side, stops for him, and gives way as he leaves: what was at the rim of its sector is beside it then."""
    creeping, side = [SE2(0.01 * k, 0.0) for k in range(60)], (0.49, -0.66)
    poses = [*creeping, *[creeping[-1]] * 20, *[SE2(0.59, -0.04)] * 120]
    comes = [(side[0], side[1] - 0.06 * k) for k in range(22, -1, -1)]
    leaves = [(side[0], side[1] - 0.04 - 0.06 * k) for k in range(40)]
    people = [*[None] * 37, *comes, *[side] * 20, *leaves, *[None] * 80]
    most, left = walk(BlindMemory(0.72, 12.0), people, poses)
    assert most > 0, "his near side lies beside the sector"
    assert left == 0


@pytest.mark.parametrize("radius", [0.04, 0.06])
def test_a_leg_that_a_robot_drove_up_to_is_held_though_somebody_passed_it(radius: float) -> None:
    """He walks past while the robot stands beside the leg, and nothing is seen for a long time then."""
    memory, now = BlindMemory(0.72, 12.0), 0.0
    leg = (0.4, -0.41 - radius)
    poses = [SE2(float(x), 0.0) for x in [*[-2.0] * 20, *np.arange(-2.0, 0.5, 0.04)]]
    poses += [poses[-1]] * 200
    passer = [None] * 100 + [(-1.0 + 0.05 * k, -0.95) for k in range(60)] + [None] * 200
    for pose, person in zip(poses, passer, strict=False):
        now += 0.05
        points = around_corner(leg, pose, radius)
        if person is not None:
            other = around_corner(person, pose)
            eye = np.array([0.6, -0.4])
            near, far = (np.hypot(*(p[:, :2] - eye).T) for p in (points, other))
            points = np.concatenate((points[near < 2.0], other[far < 2.0]))
        kept = memory.update(points, pose, CORNER, SIDE, (), now)
    assert len(kept) > 0


@pytest.mark.parametrize("drift", [-0.06, -0.03, 0.03, 0.06])
def test_drifting_odometry_makes_no_visitor_of_a_post(drift: float) -> None:
    """By so much to the side of the way: where the post is by odometry now, a scan of a moment ago saw it a hand's breadth beside."""
    memory, now, post, held = BlindMemory(0.72, 12.0), 0.0, (0.4, -0.45), 0
    for x in [*np.arange(-3.0, 0.5, 0.02), *[0.48] * 120]:
        now += 0.05
        seen = around_corner(post, SE2(float(x), 0.0), 0.04)
        held += len(memory.update(seen, SE2(float(x), drift * float(x)), CORNER, SIDE, (), now))
        assert not memory._comers.came.any()
    assert held > 0


def test_a_post_beside_which_somebody_touched_the_robot_is_no_visitor() -> None:
    """He stands between the robot and nothing, a hand's breadth from the post, and goes; the robot had driven up to the post."""
    memory, now, post = BlindMemory(0.72, 12.0), 0.0, (0.2, -0.45)
    poses = [*[SE2(float(x), 0.0) for x in np.arange(-2.0, 0.5, 0.04)], *[SE2(0.5, 0.0)] * 300]
    people = [*[None] * 100, *[(-0.15, -2.0 + 0.06 * k) for k in range(23)], *[(-0.15, -0.66)] * 40]
    people += [None] * (len(poses) - len(people))
    for pose, person in zip(poses, people, strict=True):
        now += 0.05
        points = around_corner(post, pose, 0.04)
        if person is not None:
            points = np.concatenate((points, around_corner(person, pose)))
        kept = memory.update(points, pose, CORNER, SIDE, (), now)
    at_post = np.hypot(*(poses[-1].transform(kept[:, :2]) - np.array(post)).T) < 0.08
    assert at_post.any()


@pytest.mark.parametrize("seed", range(5))
def test_what_a_scan_says_of_places_is_what_its_twin_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    azimuth, ranges = np.sort(rng.uniform(-np.pi, np.pi, 120)), rng.uniform(0.6, 3.0, 120)
    points = ranges[:, None] * np.column_stack((np.cos(azimuth), np.sin(azimuth)))
    places, returns = rng.uniform(-1.3, 1.3, (200, 2)), rng.uniform(-1.3, 1.3, (80, 2))
    limits, tolerances = np.array([[3.0, 2.9], [0.1, 1.5]]), (0.01, 0.05, 0.15, 0.3)

    def testimony(place: np.ndarray) -> str:
        r, a = np.hypot(*place), np.arctan2(place[1], place[0])
        if r > 1.5:
            return "nothing"
        there = np.abs(azimuth - a) <= 0.01
        beside = np.abs((azimuth - a + np.pi) % (2.0 * np.pi) - np.pi) <= np.arctan2(0.05, r)
        if r < 0.1 or not (0.1 <= a % (2.0 * np.pi) <= 5.9):
            return "blind"
        if (ranges[there | beside] <= r + 0.05).any():
            return "stood"
        return "through" if there.any() else "blind"

    through = np.array([testimony(p) == "through" for p in returns])
    expected, before = [], rng.choice([looks.UNKNOWN, looks.CAME, looks.WAS_THERE], 200).astype(np.uint8)
    for place, was in zip(places, before, strict=True):
        is_empty = np.hypot(*(points - place).T).min() >= 0.15
        near = np.hypot(*(returns - place).T) <= 0.3
        said = testimony(place)
        if said == "stood" or (said == "blind" and not is_empty):
            now = looks.WAS_THERE
        elif said == "through" or (said == "blind" and was == looks.UNKNOWN and bool((near & through).any())):
            now = looks.CAME
        else:
            now = int(was)
        expected.append(looks.CAME if was == looks.CAME else now)
    out = before.copy()
    looks.mark_comers(azimuth, ranges, points, limits, tolerances, places, returns, np.empty(80, np.uint8), out)
    assert out.tolist() == expected
    assert set(expected) == {looks.UNKNOWN, looks.CAME, looks.WAS_THERE}
