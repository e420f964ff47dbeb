"""Somebody nearer than a scanner of many rings can see is where it falls silent, and nowhere else."""

import math

import numpy as np
import pytest

from ambler.core.messages import Odometry, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.nodes.local_view import LocalView
from ambler.perception.mover_tracker import MoverTracker
from ambler.perception.silent_sectors import SilentSectors, sees_too_late
from ambler.sim.robots import robot_named
from tests.perception.test_mover_tracker import ROOM, feed, known_at

RANGE_MIN = 0.4
HEIGHT = 0.8


def sweep(somebody: tuple[float, float] | None, wall: float = 5.0, rings=range(-15, 16, 2)) -> np.ndarray:
    """Returns of a perfect scanner over a floor within a round wall; who stands before it is a disc of 0.25 m."""
    azimuth, rise = (a.ravel() for a in np.meshgrid(np.arange(0.1, 360.0), np.array(list(rings)), indexing="ij"))
    azimuth, rise = np.radians(azimuth), np.radians(rise)
    away = np.full(len(azimuth), wall)
    away[rise < 0.0] = np.minimum(wall, HEIGHT / -np.tan(rise[rise < 0.0]))
    if somebody is not None:
        along = np.cos(azimuth) * somebody[0] + np.sin(azimuth) * somebody[1]
        square = 0.25**2 - (math.hypot(*somebody) ** 2 - along**2)
        hit = (square > 0.0) & (along > 0.0)
        away[hit] = np.minimum(away[hit], along[hit] - np.sqrt(square[hit]))
    points = np.column_stack((away * np.cos(azimuth), away * np.sin(azimuth), away * np.tan(rise)))
    return points[(away / np.cos(rise) >= RANGE_MIN) & (away < 100.0)].astype(np.float32)


@pytest.mark.parametrize("degrees", [0.0, 37.0, 178.0, 270.0])
@pytest.mark.parametrize("away", [0.42, 0.5])
def test_who_is_nearer_than_it_sees_stands_where_it_is_silent(degrees: float, away: float) -> None:
    silences, angle = SilentSectors(RANGE_MIN), math.radians(degrees)
    place = (away * math.cos(angle), away * math.sin(angle))
    assert len(silences.update(sweep(None))) == 0
    found = silences.update(sweep(place))
    assert len(found) == 1
    assert math.dist(found[0], place) < 0.15


def test_what_it_sees_is_not_silent_and_a_mast_was_never_heard() -> None:
    silences = SilentSectors(RANGE_MIN)
    for somebody in (None, (1.0, 0.5), (0.9, 0.0)):
        assert len(silences.update(sweep(somebody))) == 0
    fixed = SilentSectors(RANGE_MIN)
    for _ in range(3):
        assert len(fixed.update(sweep((0.45, 0.0)))) == 0, (
            "what stood there from the beginning may be a part of the robot"
        )


def test_a_silence_that_lasts_is_no_news() -> None:
    """A robot that stands on a slope looks over the ground behind itself for as long as it stands there."""
    silences = SilentSectors(RANGE_MIN)
    silences.update(sweep(None))
    found = [len(silences.update(sweep((0.45, 0.0)))) for _ in range(200)]
    assert found == [1] * 150 + [0] * 50
    silences.update(sweep(None))
    assert len(silences.update(sweep((0.45, 0.0)))) == 1


def test_silence_means_nothing_to_who_looks_into_the_open() -> None:
    silences = SilentSectors(RANGE_MIN)
    silences.update(sweep(None))
    assert len(silences.update(sweep(None, wall=1000.0, rings=range(1, 16, 2)))) == 0


def test_who_was_tracked_and_steps_out_of_sight_at_the_robot_stays_known() -> None:
    """He comes as near as 0.5 m, where nothing is seen of him any more; a silence that nobody came to is nobody."""
    tracker, rng = MoverTracker(), np.random.default_rng(3)
    for k in range(60):
        place = (max(0.5, 3.0 - 0.12 * k), 0.2)
        is_hidden = place[0] == 0.5
        silent = np.array([[0.47, 0.18], [-0.3, -1.5]]) if is_hidden else np.zeros((0, 2))
        movers = feed(tracker, k, [] if is_hidden else [place], ROOM, SE2(), rng, silent=silent)
        if k >= 6:
            assert known_at(movers, place)
        assert not known_at(movers, (-0.3, -1.5))
    for k in range(60, 70):
        movers = feed(tracker, k, [], ROOM, SE2(), rng)
    assert len(movers) == 0, "who no longer hides there has left"


def test_a_silence_that_comes_and_goes_is_nobody_after_some_seconds() -> None:
    """A wall as near as the scanner begins to see flickers, where somebody was a moment ago."""
    tracker, rng = MoverTracker(), np.random.default_rng(3)
    known = []
    for k in range(400):
        place = (max(0.5, 3.0 - 0.12 * k), 0.2)
        flickers = place[0] == 0.5 and k % 3 > 0
        silent = np.array([[0.47, 0.18]]) if flickers else np.zeros((0, 2))
        movers = feed(tracker, k, [] if place[0] == 0.5 else [place], ROOM, SE2(), rng, silent=silent)
        known.append(known_at(movers, place))
    assert all(known[30:150]), "he may hide there"
    assert not any(known[210:]), "nobody has been seen for long"


@pytest.mark.parametrize("seed", range(4))
def test_who_comes_into_sight_again_where_he_hid_is_known_at_once(seed: int) -> None:
    """He leans on the robot for some seconds, and slides along it until rays meet a piece of him."""
    tracker, rng = MoverTracker(), np.random.default_rng(seed)
    for k in range(90):
        place = (max(0.5, 3.0 - 0.12 * k), 0.2)
        if k >= 60:
            place = (0.5, 0.2 + 0.02 * (k - 60))
        is_hidden = place[0] == 0.5 and k < 64
        silent = np.array([[0.47, place[1]]]) if is_hidden else np.zeros((0, 2))
        movers = feed(tracker, k, [] if is_hidden else [place], ROOM, SE2(), rng, silent=silent)
        if k >= 10:
            assert known_at(movers, place), k


@pytest.mark.parametrize(("robot", "is_late"), [("spot", True), ("go2", False), ("mecanum", False)])
def test_only_who_may_have_somebody_nearer_than_it_sees_listens_for_silence(robot: str, is_late: bool) -> None:
    """A VLP-16 sees nothing nearer than 0.4 m, 0.25 m from a flank; a Mid-360 sees from 0.1 m on, deep inside the robot."""
    model = robot_named(robot).model
    assert sees_too_late(model, model.clouds[0]) == is_late


def test_the_controllers_view_of_spot_knows_who_leans_on_its_flank() -> None:
    """He walks up from the left until no ray meets him; the robot stands somewhere in odom, turned."""
    model = robot_named("spot").model
    mount, place, nothing = model.clouds[0], SE2(2.0, -1.0, 0.7), np.zeros((6, 6))
    view = LocalView(model, LocalCostmap(LocalCostmapConfig(), model))
    for k in range(60):
        stamp_ns, away = k * 100_000_000, max(0.45, 3.0 - 0.12 * k)
        odometry = Odometry(stamp_ns, "odom", "base", SE3.from_se2(place), (0.0,) * 3, (0.0,) * 3, nothing, nothing)
        view.add_odometry(odometry)
        points = sweep((0.0, away))
        flat = np.zeros(len(points), np.float32)
        view.add_cloud(PointCloud(stamp_ns, mount.frame, points, flat, flat, flat.astype(np.uint16)))
    x, y, _ = mount.base_from_sensor.translation
    somebody = place.transform(np.array([[x, y + away]]))[0]
    assert known_at(view.movers(stamp_ns), (float(somebody[0]), float(somebody[1])))
