"""A made map knows how far it is bent: by how far its keyframes lie from where their scans match it."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.localization import map_bend
from ambler.localization.map_bend import LEAST, MapBend, measure_bend
from tests.localization import rooms


def keyframes(count: int, off: float, turned: float) -> list[tuple[rooms.F32, SE2]]:
    """Scans in the office with poses that are wrong by normal errors of these sizes (m along each axis, rad)."""
    rng, room = np.random.default_rng(5), rooms.office()
    out = []
    for _ in range(count):
        pose = SE2(float(rng.uniform(1.0, 4.0)), float(rng.uniform(3.5, 5.0)), float(rng.uniform(-3.0, 3.0)))
        scan = room.scan(pose, rng)
        dx, dy, turn = rng.standard_normal(3) * (off, off, turned)
        out.append((scan, SE2(pose.x + dx, pose.y + dy, pose.yaw + turn)))
    return out


@pytest.mark.parametrize(("off", "turned"), [(0.02, 0.004), (0.04, 0.0)])
def test_the_spread_of_keyframes_about_their_map_is_told(off: float, turned: float) -> None:
    bend = measure_bend(*rooms.office().occupancy(), keyframes(120, off, turned))
    assert bend.position == pytest.approx(off, rel=0.2)
    assert bend.yaw == pytest.approx(turned, rel=0.25, abs=0.0008)


def test_a_stiff_map_is_hardly_bent_and_few_keyframes_tell_nothing() -> None:
    office = rooms.office().occupancy()
    assert measure_bend(*office, keyframes(60, 0.0, 0.0)).position < 0.004
    assert measure_bend(*office, keyframes(LEAST - 1, 0.05, 0.0)) == MapBend()


def test_a_corridor_that_does_not_determine_the_pose_tells_nothing() -> None:
    room, rng = rooms.corridor(), np.random.default_rng(2)
    poses = [SE2(float(x), 1.0, 0.0) for x in np.linspace(25.0, 35.0, 40)]
    scans = [(room.scan(pose, rng, reach=10.0), SE2(pose.x + 0.3, pose.y, 0.0)) for pose in poses]
    assert measure_bend(*room.occupancy(), scans) == MapBend()


def test_a_part_of_the_map_at_a_time_tells_what_the_whole_map_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    cells, spec = rooms.office().occupancy()
    scans = keyframes(80, 0.03, 0.003)
    monkeypatch.setattr(map_bend, "PLACE", 1000.0)
    monkeypatch.setattr(map_bend, "BORDER", 1000.0)
    whole = measure_bend(cells, spec, scans)
    monkeypatch.setattr(map_bend, "PLACE", 0.7)
    monkeypatch.setattr(map_bend, "BORDER", 3.0)
    far = spec.origin_x - 200 * spec.resolution, spec.origin_y - 200 * spec.resolution
    wide = GridSpec(spec.resolution, spec.width + 400, spec.height + 400, *far)
    parts = measure_bend(np.pad(cells, 200, constant_values=-1), wide, scans)
    assert (parts.position, parts.yaw) == pytest.approx((whole.position, whole.yaw), rel=1e-6)


def test_keyframes_beside_the_map_or_where_it_has_no_wall_are_left_out() -> None:
    cells, spec = rooms.office().occupancy()
    away = [(points, SE2(pose.x + 500.0, pose.y, pose.yaw)) for points, pose in keyframes(30, 0.0, 0.0)]
    assert measure_bend(cells, spec, away) == MapBend()
    bend = measure_bend(cells, spec, [*away, *keyframes(60, 0.02, 0.004)])
    assert bend == measure_bend(cells, spec, keyframes(60, 0.02, 0.004))
    assert measure_bend(np.zeros_like(cells), spec, keyframes(30, 0.0, 0.0)) == MapBend()


def test_a_map_that_does_not_fit_its_geometry_is_refused() -> None:
    cells, spec = rooms.office().occupancy()
    with pytest.raises(BadInputError, match="description"):
        measure_bend(cells[:-1], spec, keyframes(30, 0.0, 0.0))
