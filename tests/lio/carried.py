"""A short walk with a small scanner through a hall, simulated once for all tests."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import HandRig, RigScan
from ambler.sim.sensors import VLP_16
from ambler.sim.site import draw_hall

SMALL = replace(VLP_16, columns=360)


@functools.cache
def walk() -> tuple[HandRig, tuple[RigScan, ...]]:
    """A loop of 25 metres, two seconds of rest at both ends."""
    site = draw_hall(3, 25.0)
    rig = HandRig(site.world, HandPath(site.way), SMALL, 3)
    return rig, tuple(rig.scans())


def scans_of(recorded: tuple[RigScan, ...]) -> list[CloudScan]:
    """What the filter is given of them."""
    return [CloudScan(s.cloud, s.imu, s.odometry) for s in recorded]


def distance(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Metres between two places."""
    return math.dist(a, b)
