"""The life of submaps: two are active, a new one starts when the newer is half full, the full one ends and rests."""

import tracemalloc

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.grids.probability_grid import InsertionConfig
from ambler.slam2d.submaps import ActiveSubmaps, Drawing, PackedDrawing, RecentDrawings, Submap
from tests.registration.room import distance_to_walls, scan_at
from tests.slam2d.drives import oval

HALF = 6


def test_submaps_start_overlap_and_finish() -> None:
    active = ActiveSubmaps(InsertionConfig(), HALF)
    taken: dict[int, list[int]] = {}
    finished: list[tuple[Submap, np.ndarray]] = []
    assert not active.submaps
    for k, pose in enumerate(oval(0.3)):
        used, done = active.insert(scan_at(pose), pose)
        for submap in used:
            taken.setdefault(submap.index, []).append(k)
        assert [s.index for s in used] in ([0], [k // HALF - 1, k // HALF])
        assert [s.is_finished for s in active.submaps] in ([False], [False, False])
        assert active.target is active.submaps[0]
        assert len(active.submaps) <= 2
        if done is not None:
            assert done.is_finished
            finished.append((done, done.grid.cells.copy()))
    assert len(finished) == 7
    for submap, cells in finished:
        k = submap.index
        assert taken[k] == list(range(k * HALF, (k + 2) * HALF))
        assert submap.scans == 2 * HALF
        assert np.array_equal(submap.grid.cells, cells)
        border = np.concatenate((cells[:2].ravel(), cells[-2:].ravel(), cells[:, :2].ravel(), cells[:, -2:].ravel()))
        assert not border.any()  # cropped to a margin of two cells


def test_a_submap_lies_on_the_lattice_near_its_first_scan_and_shows_the_walls() -> None:
    active, pose = ActiveSubmaps(InsertionConfig(), HALF), SE2(1.23, -0.41, 0.7)
    (submap,), _ = active.insert(scan_at(pose), pose)
    origin = submap.local_from_submap
    assert origin.yaw == 0.0
    assert np.array([origin.x, origin.y]) / 0.05 == pytest.approx(np.rint(np.array([origin.x, origin.y]) / 0.05))
    assert origin.distance_to(pose) < 0.036
    assert (submap.local_from_submap @ submap.to_submap(pose)).distance_to(pose) < 1e-12
    cells = np.column_stack(np.nonzero(submap.grid.cells > 16384))
    occupied = submap.local_from_submap.transform(submap.grid.spec.centers_of(cells))
    assert len(occupied) > 150
    assert distance_to_walls(occupied).max() < 0.036  # the wall crosses the cell


def test_submaps_end_by_way_where_scans_are_few() -> None:
    active = ActiveSubmaps(InsertionConfig(), 100, distance_per_submap=3.0)
    spans: dict[int, list[float]] = {}
    for k in range(30):
        pose = SE2(0.8 * k, 0.0, 0.0)
        for submap in active.insert(scan_at(SE2()), pose)[0]:
            spans.setdefault(submap.index, []).append(pose.x)
    complete = [xs for xs in spans.values() if xs[-1] < 23.0]
    assert len(complete) >= 3
    assert all(5.5 < xs[-1] - xs[0] < 8.0 for xs in complete)  # two halves of four steps


def test_a_scan_after_a_long_way_counts_more_often() -> None:
    grids = []
    for step in (0.1, 1.0):
        active = ActiveSubmaps(InsertionConfig(), 100, step=step)
        for _ in range(2):
            active.insert(scan_at(SE2()), SE2())
        (submap,), _ = active.insert(scan_at(SE2()), SE2(0.0, 0.0, 0.5))
        grids.append(int(submap.grid.cells.max()))
    assert grids[0] > grids[1] + 1000


def finished_submaps() -> list[Submap]:
    active = ActiveSubmaps(InsertionConfig(), HALF)
    ended = [active.insert(scan_at(pose), pose)[1] for pose in oval(0.3)]
    return [submap for submap in ended if submap is not None]


def test_a_finished_submap_takes_an_eighth_of_its_memory() -> None:
    for submap in finished_submaps():
        packed = submap.drawing
        assert isinstance(packed, PackedDrawing)
        assert packed.grid.spec == submap.spec == submap.grid.spec
        assert submap.grid.cells.flags.writeable  # kernels are compiled for such
        tracemalloc.start()  # sees the room that is kept, too
        again = submap.grid.packed()
        size = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        assert again.data == packed.grid.data
        assert size < submap.grid.cells.nbytes / 8


def test_the_drawings_that_were_asked_for_last_lie_ready() -> None:
    submaps = finished_submaps()[:4]
    recent = RecentDrawings(2)
    for submap in submaps:
        submap.recent = recent
    first = submaps[0].grid
    assert submaps[0].grid is first
    assert submaps[1].grid is submaps[1].grid
    assert submaps[0].grid is first, "asked for again, it is the newer of the two"
    assert submaps[2].passing_grid() is not submaps[2].passing_grid(), "one who passes puts nothing away"
    assert submaps[0].passing_grid() is first
    assert recent.find(1) is not None
    assert submaps[2].lines is submaps[2].lines
    assert recent.find(1) is None
    assert recent.find(0) is not None
    assert np.array_equal(submaps[1].passing_grid().cells, submaps[1].grid.cells)


def test_one_who_takes_scans_is_not_packed() -> None:
    (submap,), _ = ActiveSubmaps(InsertionConfig(), HALF).insert(scan_at(SE2()), SE2())
    assert isinstance(submap.drawing, Drawing)
    assert not submap.is_finished
    assert submap.passing_grid() is submap.grid
