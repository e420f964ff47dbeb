"""Docking by the scanner in closed loop: a V-shaped notch and retro-reflectors, ranges with 4 mm of noise, the gate watching."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.docking.detection import DockDetector, DockObservation
from ambler.docking.dock import Dock
from ambler.docking.reflector_dock import ReflectorDockDetector
from ambler.docking.v_shape_dock import VShapeDockDetector
from tests.docking.docks import NOTCH, REFLECTORS, scan_of, segments_of_v
from tests.missions.dock_site import PERIOD, S
from tests.missions.test_dock_with_camera import GateSite

MAP_FROM_DOCK = SE2(4.0, 1.0, 0.5)


class ScanSite(GateSite):
    """A site whose dock is seen by a scanner at the base's origin, ten times a second."""

    def __init__(self, dock: Dock, detector: DockDetector, seed: int, staging_error: SE2) -> None:
        super().__init__(seed, staging_error)
        self.dock = replace(dock, map_from_dock=MAP_FROM_DOCK)
        self.detector = detector
        self.surface = MAP_FROM_DOCK.transform(np.array([[5.0, 0.0]]))

    def _see(self) -> None:
        if not self.is_looking or self.drive is not None or self.now_ns % (5 * round(PERIOD * S)):
            return
        base_from_dock = self.pose.inverse() @ self.true_dock
        if self.dock.v_shape is not None:
            observation = DockObservation(
                self.now_ns, None, scan_of(segments_of_v(self.dock, base_from_dock), self.rng)
            )
        else:
            a, b = base_from_dock.transform(np.array([[0.7, -0.5], [0.7, 0.5]]))
            points = scan_of(np.array([[*a, *b]]), self.rng, step=math.radians(0.17))
            strips = base_from_dock.transform(self.dock.reflectors)
            away = np.hypot(*(points[:, None] - strips[None]).transpose(2, 0, 1)).min(axis=1)
            observation = DockObservation(self.now_ns, None, points, np.where(away < 0.025, 240.0, 60.0))
        odom = self.odom()
        detection = self.detector.detect(observation, self.tracker.expected(odom))
        if detection is not None:
            self.tracker.update(detection, odom, self.now_ns)


@pytest.mark.parametrize("dock", [NOTCH, REFLECTORS], ids=lambda d: d.name)
def test_a_scan_leads_the_robot_into_the_dock(dock: Dock) -> None:
    errors, turns = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        off = SE2(rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
        detector = VShapeDockDetector(dock) if dock.v_shape is not None else ReflectorDockDetector(dock)
        site = ScanSite(dock, detector, seed, off)
        ended = site.run()
        assert ended.code == "SUCCEEDED", ended.text
        d = site.dock_from_base
        errors.append(math.hypot(d.x, d.y))
        turns.append(abs(d.yaw))
    assert max(errors) < 0.010
    assert max(turns) < math.radians(0.6)
