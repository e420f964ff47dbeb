"""Which loop closures are found: the right place with its shift, and nothing where the scan is another's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2, wrap_angle
from ambler.grids.probability_grid import InsertionConfig
from ambler.registration.correlative import Window
from ambler.registration.line_field import LineConfig, LineField
from ambler.registration.planar_scan import PlanarScan, filter_voxels_adaptively
from ambler.slam2d.agreement import sort_closures
from ambler.slam2d.back_end import BackEnd
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.graph import Edge, EdgeKind
from ambler.slam2d.loop_candidates import Candidate, Node
from ambler.slam2d.loop_closure import Closure, LoopSearcher, Usual
from ambler.slam2d.slam import Slam2d
from ambler.slam2d.submaps import ActiveSubmaps, Drawing, Submap
from tests.registration.room import CORRIDOR, WALLS, box_at, loop_of, scan_at
from tests.slam2d.drives import PERIOD_NS, drive, oval, run, short_submaps

VIEWS = [
    SE2(x, y, 0.7 * k) for k, (x, y) in enumerate([(0.0, 0.0), (1.0, 0.5), (-1.0, 1.0), (2.0, 0.5), (-2.5, -1.0)] * 2)
]
# Another room, with as many walls about as far away: scans of it fit the first one here and there, as chance has it.
ELSEWHERE = np.array(
    [
        *box_at(0.0, 0.0, 7.6, 0.4),
        *box_at(2.2, 1.9, 0.8, 0.2),
        *box_at(-1.8, -1.9, 1.0, 1.0),
        *box_at(-2.0, 2.0, 0.5, 0.7),
    ]
)


ALONG = [SE2(0.3 * k, 0.02 * (-1) ** k, 0.0) for k in range(10)]
NICHE = np.array([*CORRIDOR, *box_at(2.5, -0.9, 0.5, 0.0), *box_at(-3.0, 0.9, 0.4, 0.0)])


def submap(views: Sequence[SE2] = VIEWS, walls: np.ndarray = WALLS, reach: float = 30.0) -> Submap:
    """The finished submap of the room, or of other walls."""
    active = ActiveSubmaps(InsertionConfig(), len(views) // 2)
    for view in views:
        _, finished = active.insert(scan_at(view, walls=walls, range_max=reach), view)
    assert finished is not None
    return finished


class Search:
    """A search of the room by a node with a scan, where local matches usually reach a score and a share of inliers."""

    def __init__(
        self, loop: LoopConfig | None = None, usual: float = 0.75, reach: float = 1.0, inliers: float = 0.9
    ) -> None:
        self.loop, self.usual, self.reach = loop or LoopConfig(), Usual(usual, inliers), reach
        self.searcher = LoopSearcher(self.loop, GraphConfig(), 0.35)

    def of(
        self, scan: PlanarScan, believed: SE2, where: Submap | None = None, *, is_partial: bool = False
    ) -> Closure | None:
        """Search a scan that is believed at a pose of the submap, that of the room or another one."""
        points = filter_voxels_adaptively(scan.points, self.loop.max_voxel, self.loop.min_points)
        node = Node(7, 0, SE2(), points, filter_voxels_adaptively(scan.points, 0.3, 200), (0.0, 0.0), 9, 0.0)
        window = Window(self.reach, math.radians(20.0))
        candidate = Candidate(3, 0, believed, window, np.diag([0.04, 0.04, 0.01]), is_partial)
        return self.searcher.search(candidate, node, where or submap(), 1, self.usual)


@pytest.mark.parametrize("reach", [1.0, 6.0])
def test_the_right_place_is_found_with_its_surprise(reach: float) -> None:
    """In a window that is searched cell by cell, and in a wide one that is searched on coarse cells first."""
    truth, off = SE2(0.7, 0.4, 0.9), SE2(0.5, -0.3, 0.15)
    believed = truth @ off
    closure = Search(reach=reach).of(scan_at(truth), believed)
    assert closure is not None
    found = closure.edge.from_from_to
    assert found.distance_to(truth) < 0.03
    assert abs(found.yaw - truth.yaw) < 0.01
    assert (closure.edge.edge_from, closure.edge.edge_to, closure.node, closure.submap) == (1, 7, 3, 0)
    expected = (found.distance_to(believed) ** 2 / 0.0425 + 0.15**2 / 0.0101) / 3.0
    assert closure.surprise == pytest.approx(expected, rel=0.1)
    assert closure.prior_sigma == pytest.approx(0.2)


def test_scans_of_another_room_close_no_loop() -> None:
    """From wherever it is believed: neither with a usual score of a good map nor with that of a poor one."""
    for k, believed in enumerate(VIEWS[:5]):
        scan = scan_at(SE2(0.3 * k, -0.2 * k, 0.4 * k), walls=ELSEWHERE)
        for usual in (0.8, 0.55):
            assert Search(usual=usual).of(scan, believed) is None, (k, usual)


def test_where_points_usually_lie_on_lines_a_closure_without_any_is_none() -> None:
    """A depth camera's few points fit the cells of walls that it met from elsewhere, in many places."""
    truth = SE2(0.7, 0.4, 0.9)
    place = replace(submap(), drawing=Drawing(submap().grid, LineField(LineConfig())))
    loop = replace(LoopConfig(), refine=replace(LoopConfig().refine, weak_ratio=0.01))
    for share, is_found in ((0.6, False), (0.02, True), (0.0, True)):
        search = Search(loop)
        search.usual = replace(search.usual, line_share=share)
        assert (search.of(scan_at(truth), truth, place) is not None) == is_found, share
        assert search.of(scan_at(truth), truth) is not None, share


@pytest.mark.parametrize("scale", [1.03, 1.05, 1.08])
def test_a_room_of_the_same_shape_that_is_larger_is_another_place(scale: float) -> None:
    """Its corners and half of its walls can be laid over each other, and a map in which few returns lie on walls asks for no more; but the score is
    far below that of a match in the same place."""
    truth = SE2(0.7, 0.4, 0.9)
    scan = scan_at(truth)
    larger = replace(scan, points=scan.points * np.float32(scale))
    poor = Search(inliers=0.5)
    assert poor.of(scan, truth) is not None
    assert poor.of(larger, truth) is None


def test_the_usual_score_is_what_local_matches_reach() -> None:
    """The back end asks for three quarters of it, at least."""
    slam = Slam2d(short_submaps(8))
    results = run(slam, drive(oval(0.4)), with_odometry=True, with_background=False)
    back_end: BackEnd = slam._back_end
    usual = back_end._usual.score / (1.0 - 0.98 ** len(back_end.nodes))  # a mean that began at zero
    assert usual == pytest.approx(np.mean([r.score for r in results[1:]]), abs=0.1)


def test_a_scan_half_of_which_fits_is_no_loop_closure() -> None:
    """Half of the beams end in free space, as when a different place shares one wall with this one."""
    truth = SE2(0.7, 0.4, 0.9)
    scan = scan_at(truth)
    points = scan.points.copy()
    is_aside = (np.arctan2(points[:, 1], points[:, 0]) % (2.0 * math.pi)) < math.pi
    points[is_aside] *= np.float32(0.45)
    half = replace(scan, points=points)
    assert Search().of(half, truth) is None


def test_between_smooth_walls_that_tell_nothing_of_the_place_along_them_no_loop_is_closed() -> None:
    """However well a scan fits; where two things stand at the walls, it is closed, and there."""
    truth, believed = SE2(1.1, 0.1, 0.05), SE2(1.6, 0.0, 0.0)
    for walls in (CORRIDOR, NICHE):
        scan = scan_at(truth, walls=walls, rng=np.random.default_rng(3), range_max=8.0)
        closure = Search().of(scan, believed, submap(ALONG, walls, 8.0))
        if walls is CORRIDOR:
            assert closure is None
        else:
            assert closure is not None
            assert closure.edge.from_from_to.distance_to(truth) < 0.04


def test_where_no_lines_are_known_cells_that_hold_a_scan_weakly_close_no_loop() -> None:
    """Two scans leave too few returns for lines; the cells of smooth walls still seem to tell a little along them, those of a room tell enough."""
    truth, believed = SE2(1.1, 0.1, 0.05), SE2(1.6, 0.0, 0.0)
    for walls, views, reach in ((CORRIDOR, ALONG, 8.0), (WALLS, VIEWS, 30.0)):
        scan = scan_at(truth, walls=walls, rng=np.random.default_rng(3), range_max=reach)
        where = submap(views[:2], walls, reach)
        assert not where.lines.fit(filter_voxels_adaptively(scan.points, 0.3, 200), (0.0, 0.0), truth).is_held
        closure = Search(usual=0.55, inliers=0.5).of(scan, believed, where)
        if walls is CORRIDOR:
            assert closure is None
        else:
            assert closure is not None
            assert closure.edge.from_from_to.distance_to(truth) < 0.05


# A hall with things in it, all of which its far end hardly shows.
HALL = np.array(
    [
        *loop_of((-12.0, -6.0), (12.0, -6.0), (12.0, 6.0), (-12.0, 6.0)),
        *box_at(-4.0, 3.0, 1.0, 0.3),
        *box_at(-6.5, -3.5, 0.8, 0.8),
        *box_at(-10.5, 1.5, 1.2, 0.0),
        *box_at(5.0, -3.0, 1.4, 0.5),
        *box_at(8.0, 3.5, 0.9, 1.0),
        *box_at(3.5, 4.0, 0.7, 0.2),
    ]
)
WEST = [SE2(-7.0 + 0.3 * k, -0.6 + 0.2 * (k % 3), 0.6 * k) for k in range(10)]


def test_from_afar_a_scan_is_placed_by_the_part_that_both_saw() -> None:
    """Most of it lies where the submap knows nothing, and draws it nowhere; as a whole it fits too badly."""
    west = submap(WEST, HALL, 8.0)
    for k, view in enumerate((SE2(3.5, 0.5, 2.8), SE2(2.5, -1.0, 0.4))):
        scan, truth = scan_at(view, walls=HALL, rng=np.random.default_rng(k), range_max=30.0), west.to_submap(view)
        believed = truth @ SE2(0.5, -0.4, 0.05)
        assert Search(reach=1.5, usual=0.65, inliers=0.7).of(scan, believed, west) is None
        closure = Search(reach=1.5, usual=0.65, inliers=0.7).of(scan, believed, west, is_partial=True)
        assert closure is not None
        assert closure.is_partial
        assert closure.edge.from_from_to.distance_to(truth) < 0.06
        assert abs(wrap_angle(closure.edge.from_from_to.yaw - truth.yaw)) < 0.006


def test_from_afar_a_scan_that_sees_too_little_of_the_submap_is_placed_nowhere() -> None:
    west, view = submap(WEST, HALL, 8.0), SE2(7.0, 0.5, 2.8)
    little = scan_at(view, walls=HALL, range_max=9.0)
    assert Search(reach=1.5, usual=0.65, inliers=0.7).of(little, west.to_submap(view), west, is_partial=True) is None


# Three sides of a square hall: its end is 17 m from its start, and sees it.
AROUND = [SE2(-8.5 + 0.2 * k, -8.5, 0.0) for k in range(85)]
AROUND += [SE2(8.5, -8.5 + 0.2 * k, 0.5 * math.pi) for k in range(85)]
AROUND += [SE2(8.5 - 0.2 * k, 8.5, math.pi) for k in range(85)]
SQUARE = np.array(
    [
        *loop_of((-12.0, -12.0), (12.0, -12.0), (12.0, 12.0), (-12.0, 12.0)),
        *box_at(-10.0, -4.0, 1.5, 0.3),
        *box_at(-5.0, -11.0, 1.0, 0.8),
        *box_at(0.0, 0.0, 2.0, 0.5),
        *box_at(11.0, -2.0, 1.2, 0.1),
        *box_at(3.0, 11.0, 1.3, 0.4),
        *box_at(-9.0, 4.5, 0.8, 1.0),
        *box_at(-5.0, -4.5, 0.7, 0.2),
    ]
)


@pytest.mark.parametrize("is_allowed", [True, False])
def test_a_loop_is_closed_by_what_is_seen_of_its_start(is_allowed: bool) -> None:
    """The robot never came back to where it began; the closures are those between its end and its beginning, where those are."""
    config = short_submaps(25)
    loop = config.loop if is_allowed else replace(config.loop, partial_tries=0)
    slam = Slam2d(replace(config, loop=loop))
    course = drive(AROUND, walls=SQUARE, range_max=20.0)
    run(slam, course, with_odometry=True, rng=np.random.default_rng(1))
    slam.finish()
    back_end: BackEnd = slam._back_end
    found = [c for c in back_end.closures.values() if c.is_partial]
    if not is_allowed:
        assert not back_end.closures
        return
    assert len(found) >= 3
    for closure in found:
        node, where = back_end.nodes[closure.node], back_end.submaps[closure.submap]
        assert node.way - where.way > 15.0
        first = AROUND[0].inverse()
        truth = where.local_from_submap.inverse() @ first @ AROUND[node.stamp_ns // PERIOD_NS - 1]
        assert closure.edge.from_from_to.distance_to(truth) < 0.1


def test_what_little_speaks_for_waits_until_others_say_the_same() -> None:
    """However little it moves the map."""
    poses = np.array([[0.0, 0.0, 0.0], *((2.0 * k, 0.0, 0.0) for k in range(1, 5))])
    ways = np.array([0.0, 2.0, 4.0, 6.0, 8.0])

    def closure(node: int, off: float, *, is_partial: bool) -> Closure:
        edge = Edge(0, node, SE2(2.0 * node, off, 0.0), np.eye(3), EdgeKind.INTER)
        return Closure(edge, node, 0, is_partial=is_partial)

    alone = [closure(1, 0.1, is_partial=True)]
    assert sort_closures(alone, poses, ways, LoopConfig()) == ([], alone)
    assert sort_closures([closure(1, 0.1, is_partial=False)], poses, ways, LoopConfig())[1] == []
    believed, waiting = sort_closures(
        [closure(k, 0.1, is_partial=True) for k in range(1, 5)], poses, ways, LoopConfig()
    )
    assert (len(believed), waiting) == (4, [])
