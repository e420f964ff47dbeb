"""Scanners that turn as slowly as they tell scans, without odometry: the map is as sharp as that of a scanner that stands still."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.recordings.log_scans import LogScan, planar_matrix
from ambler.recordings.sweep import Sweep
from ambler.slam2d.offline import run_offline
from ambler.slam2d.sweep_search import find_sweep
from tests.registration.room import BEAMS, beam_angles, ranges_at
from tests.slam2d.drives import PERIOD_NS, errors, oval

PARTS = 40  # of a sweep, each taken at one instant


def scans_of(truth: list[SE2], *, backward: bool = False, sigma: float = 0.01) -> list[LogScan]:
    """Return scans without odometry whose sweep takes the whole period, of all poses but the last."""
    rng, angles = np.random.default_rng(3), beam_angles()
    out = []
    for k, (begin, end) in enumerate(pairwise(truth)):
        parts = [ranges_at(begin.interpolate(end, (i + 0.5) / PARTS), angles) for i in range(PARTS)]
        part = np.arange(BEAMS) * PARTS // BEAMS
        ranges = np.array(parts)[part[::-1] if backward else part, np.arange(BEAMS)] + rng.normal(0.0, sigma, BEAMS)
        beam = np.array([angles[0], angles[1] - angles[0], PERIOD_NS * 1e-9 / BEAMS])
        limits, mount = np.array([0.1, 30.0, 5.0]), planar_matrix(SE2())
        out.append(LogScan((k + 1) * PERIOD_NS, ranges.astype(np.float32), beam, limits, mount, ()))
    return out


def test_without_odometry_motion_compensation_does_not_swing() -> None:
    """A velocity between the poses of first beams, which err by half a sweep of the last velocity's error, alternated from scan to scan."""
    truth = [*[oval()[0]] * 4, *oval(1.5, 100)]
    result = run_offline(scans_of(truth))
    error = errors(truth[:-1], [SE2.from_array(pose) for pose in result.poses])
    error = error[8:]  # from rest to 1 m/s at once: no velocity before foretells it
    assert error[:, 0].max() < 0.04
    assert error[:, 1].max() < math.radians(1.0)
    assert result.points_on_walls_ratio > 0.99


@pytest.mark.parametrize("backward", [False, True])
def test_the_order_of_the_beams_is_found_without_odometry(backward: bool) -> None:
    """What turns is seen by the scans themselves; it had not been asked, and beams against their promise went unnoticed."""
    scans = scans_of([SE2(), SE2(), *oval(0.6, 100)], backward=backward)
    sweep, on_walls = find_sweep(scans)
    assert sweep is (Sweep.BACKWARD if backward else Sweep.FORWARD)
    assert on_walls[sweep] > max(on_walls[Sweep.NONE], 0.97)


def test_a_base_that_stands_tells_nothing_of_the_order_of_the_beams() -> None:
    assert find_sweep(scans_of([SE2(0.3, 0.2, 0.1)] * 60)) == (Sweep.FORWARD, {})
