"""The study of robots switched on in saved sites: what stands there on another day, what a standing robot sees, what counts as right."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.sim.reachable_ground import ReachableGround
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_distance import surface_distances
from ambler.sim.world_file import load_world
from ambler.studies import lost_site_study as study
from ambler.studies.standing_scans import LEANT, Stand, StandingRobot, leaning, toured_cloud

SLOPE = 0.1


def yard(slope: float = 0.0) -> ReachableGround:
    """A walled yard of 8 m by 6 m; the heights of its ground (not its surface) rise along x."""
    solids = tuple(
        Solid("wall", Shape.BOX, SE2(x, y, 0.0), sx, sy, 0.0, 2.5)
        for x, y, sx, sy in ((0.0, 3.0, 0.2, 6.0), (8.0, 3.0, 0.2, 6.0), (4.0, 0.0, 8.0, 0.2), (4.0, 6.0, 8.0, 0.2))
    )
    scene = build_scene(WorldSpec("yard", solids, SE2(4.0, 3.0, 0.0)))
    spec = GridSpec(0.1, 80, 60, 0.0, 0.0)
    heights = np.broadcast_to((slope * (np.arange(80) + 0.5) * 0.1).astype(np.float32), (1, 60, 80))
    is_open = np.ones((1, 60, 80), np.bool_)
    return ReachableGround(spec, heights, is_open, is_open, scene)


@pytest.mark.parametrize("name", ["spot", "go2"])
def test_what_a_standing_robot_sees_lies_on_the_world_wherever_it_looks(name: str) -> None:
    ground = yard()
    robot = StandingRobot(robot_named(name), ground, 1)
    odom_from_world = leaning(np.random.default_rng(2))
    for yaw in (0.0, 2.0):
        seen = robot.seen(Stand((3.0, 2.5, 0.0), yaw), odom_from_world, 5, 0.3)
        world = (odom_from_world.inverse() @ seen.map_from_imu).transform(seen.points_imu)
        assert len(world) > 100
        assert np.percentile(surface_distances(ground.scene, world), 90) < 0.12


def test_a_robot_leans_with_its_ground() -> None:
    robot = StandingRobot(robot_named("spot"), yard(SLOPE), 1)
    up = robot.world_from_base(Stand((4.0, 3.0, 4.0 * SLOPE), 0.0)).rotate((1.0, 0.0, 0.0))
    assert math.degrees(math.asin(up[2])) == pytest.approx(math.degrees(math.atan(SLOPE)), abs=1.0)
    along = robot.world_from_base(Stand((4.0, 3.0, 4.0 * SLOPE), math.pi / 2)).rotate((1.0, 0.0, 0.0))
    assert abs(along[2]) < 0.01


def test_an_odometry_leans_by_milliradians_and_heads_anywhere() -> None:
    drawn = [leaning(np.random.default_rng(k)) for k in range(300)]
    leans = [math.acos(min(1.0, pose.rotate((0.0, 0.0, 1.0))[2])) for pose in drawn]
    assert np.sqrt(np.mean(np.square(leans))) == pytest.approx(LEANT * math.sqrt(2.0), rel=0.15)
    assert np.ptp([pose.to_se2().yaw for pose in drawn]) > 6.0


def test_a_tour_saves_all_walls_where_they_are() -> None:
    ground = yard()
    cloud = toured_cloud(StandingRobot(robot_named("spot"), ground, 3), LioConfig(), np.random.default_rng(1))
    assert np.percentile(surface_distances(ground.scene, cloud.astype(np.float64)), 90) < 0.12
    high = cloud[cloud[:, 2] > 0.5]
    for axis, at in ((0, 0.1), (0, 7.9), (1, 0.1), (1, 5.9)):
        own = high[np.abs(high[:, axis] - at) < 0.15]
        assert np.ptp(own[:, 1 - axis]) > 5.0  # each wall from end to end


def test_things_that_belong_together_move_together_and_what_is_built_stays() -> None:
    world = load_world("garage-5")
    changed, moved = study.move_things(world, 0.5, np.random.default_rng(3))
    before, after = set(world.solids), set(changed.solids)
    assert {s.name for s in before - after} == {"car", "cabin"}
    cars = sum(s.name == "car" for s in world.solids)
    assert sum(s in before - after for s in world.solids if s.name == "car") == pytest.approx(0.5 * cars, abs=1.0)
    places = {(s.world_from_solid.x, s.world_from_solid.y) for s in after - before}
    assert places == {tuple(row) for row in moved.tolist()}
    assert len(after - before) == 2 * len(moved)  # a cabin on every car
    assert study.move_things(world, 0.0, np.random.default_rng(3))[0] == world


@pytest.mark.parametrize(
    ("off_m", "off_deg", "ended"), [(0.1, 1.0, "right"), (0.6, 1.0, "wrong"), (0.1, 6.0, "wrong"), (6.1, 90.0, "wrong")]
)
def test_a_place_is_wrong_by_metres_or_by_degrees(off_m: float, off_deg: float, ended: str) -> None:
    assert study.judged(3.0, off_m, off_deg).ended == ended


def test_places_of_all_levels_are_drawn_each_with_its_own_heading() -> None:
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0]])
    case = study.LostSiteCase(1, "garage", "spot")
    stands = [study.draw_stand(places, k, case) for k in range(40)]
    assert {stand.place[2] for stand in stands} == {0.0, 3.0}
    assert len({stand.yaw for stand in stands}) == 40


def told(outcomes: list[str], label: str = "garage-1-spot") -> dict[str, object]:
    found = [None if each == "unsure" else 3.0 for each in outcomes]
    columns = {"found_s": found, "found_m": found, "found_deg": found}
    return {"label": label, "outcomes": outcomes, "map_points": 9, "levels": 2, **columns}


def test_one_wrong_place_misses_the_bar_and_so_do_many_unsure_ones() -> None:
    good = study.summarize([told(["right"] * 9 + ["unsure"])])
    assert (good["bars.wrong"], good["bars.unsure"], good["right"], good["unsure"]) == (True, True, 9, 1)
    assert not study.summarize([told(["right"] * 9 + ["wrong"])])["bars.wrong"]
    assert not study.summarize([told(["right"] * 8 + ["unsure"] * 2)])["bars.unsure"]
    assert not study.summarize([told(["right"]), {"label": "x", "ended": "crashed"}])["bars.wrong"]


def test_a_robot_in_a_yard_that_looks_the_same_from_its_twin_place_says_nothing() -> None:
    """In a bare yard each place has a twin, half a turn away."""
    ground = yard()
    robot = StandingRobot(robot_named("spot"), ground, 3)
    lio = LioConfig()
    saved = study.CloudMap(toured_cloud(robot, lio, np.random.default_rng(1)), lio.localize.map)
    lost = study.be_lost(robot, saved, SE3(), Stand((3.0, 2.0, 0.0), 0.4), lio, 6.0, 1)
    assert lost.ended == "unsure"
