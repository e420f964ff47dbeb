"""Which loop closures are found: the right place with its shift, and nothing where the scan is another's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ambler.core.se2 import SE2
from ambler.grids.probability_grid import InsertionConfig
from ambler.registration.correlative import Window
from ambler.registration.planar_scan import PlanarScan, filter_voxels_adaptively
from ambler.slam2d.back_end import BackEnd
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.loop_closure import Candidate, LoopSearcher
from ambler.slam2d.slam import Slam2d
from ambler.slam2d.submaps import ActiveSubmaps, Submap
from tests.registration.room import box_at, scan_at
from tests.slam2d.drives import drive, oval, run, short_submaps

MAP_FROM_SUBMAP = SE2(0.4, -0.3, 0.2)
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


def submap() -> Submap:
    """The finished submap of the room."""
    active = ActiveSubmaps(InsertionConfig(), len(VIEWS) // 2)
    for view in VIEWS:
        _, finished = active.insert(scan_at(view), view)
    assert finished is not None
    return finished


def candidate(scan: PlanarScan, believed: SE2, loop: LoopConfig, usual: float = 0.75) -> Candidate:
    """What the back end asks for: a node with this scan, believed at a pose of the submap, where local matches usually reach `usual`."""
    points = filter_voxels_adaptively(scan.points, loop.max_voxel, loop.min_points)
    return Candidate(
        7,
        1,
        submap(),
        believed,
        Window(1.0, math.radians(20.0)),
        points,
        filter_voxels_adaptively(scan.points, 0.3, 200),
        MAP_FROM_SUBMAP,
        min(loop.min_score, loop.min_score_ratio * usual),
        loop.min_inlier_ratio_of_usual * 0.9,
    )


def searcher(loop: LoopConfig) -> LoopSearcher:
    return LoopSearcher(loop, GraphConfig(), 0.35)


def test_the_right_place_is_found_with_the_way_that_it_moves_the_node() -> None:
    loop, truth = LoopConfig(), SE2(0.7, 0.4, 0.9)
    off = SE2(0.5, -0.3, 0.15)
    wanted = candidate(scan_at(truth), truth @ off, loop)
    closure = searcher(loop).search(wanted)
    assert closure is not None
    found = closure.edge.from_from_to
    assert found.distance_to(truth) < 0.03
    assert abs(found.yaw - truth.yaw) < 0.01
    new, old = MAP_FROM_SUBMAP @ truth, MAP_FROM_SUBMAP @ truth @ off
    assert math.dist(closure.shift[:2], (new.x - old.x, new.y - old.y)) < 0.03
    assert abs(closure.shift[2] + 0.15) < 0.01
    assert (closure.edge.edge_from, closure.edge.edge_to) == (1, 7)


def test_scans_of_another_room_close_no_loop() -> None:
    """From wherever it is believed: neither with a usual score of a good map nor with that of a poor one."""
    loop = LoopConfig()
    search = searcher(loop)
    for k, believed in enumerate(VIEWS[:5]):
        scan = scan_at(SE2(0.3 * k, -0.2 * k, 0.4 * k), walls=ELSEWHERE)
        for usual in (0.8, 0.55):
            assert search.search(candidate(scan, believed, loop, usual)) is None, (k, usual)


def test_what_a_loop_closure_must_reach_lies_near_what_local_matches_reach() -> None:
    """The back end asks for three quarters of the usual score, at least: a scan half of which fits is no loop closure."""
    slam = Slam2d(short_submaps(8))
    run(slam, drive(oval(0.4)), with_odometry=True, with_background=False)
    back_end: BackEnd = slam._back_end
    usual = back_end._usual_score / (1.0 - 0.98 ** len(back_end.nodes))  # a mean that began at zero
    back_end._usual_score, back_end._usual_inliers = usual, 0.9
    finished = next(s for s in back_end.submaps if s.is_finished)
    asked = back_end._candidate(len(back_end.nodes) - 1, finished.index)
    assert 0.5 < usual < 1.0
    assert 0.65 * usual < asked.min_score < 0.9 * usual
    assert 0.6 < asked.min_inlier_ratio < 0.85


def test_a_scan_half_of_which_fits_is_no_loop_closure() -> None:
    """Half of the beams end in free space, as when a different place shares one wall with this one."""
    loop, truth = LoopConfig(), SE2(0.7, 0.4, 0.9)
    scan = scan_at(truth)
    points = scan.points.copy()
    is_aside = (np.arctan2(points[:, 1], points[:, 0]) % (2.0 * math.pi)) < math.pi
    points[is_aside] *= np.float32(0.45)
    half = replace(scan, points=points)
    assert searcher(loop).search(candidate(half, truth, loop)) is None
