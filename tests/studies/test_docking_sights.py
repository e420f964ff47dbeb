"""Looks at docks are judged in one frame, wherever in its world the dock stands and wherever the world's start is."""

import numpy as np
import pytest

from ambler.sim.world_file import load_world
from ambler.studies.docking_scans import measure_scan_detections
from ambler.studies.docking_study import measure_detections


def test_a_camera_sees_markers_and_dock_where_they_are() -> None:
    assert load_world("dock_hall").start.x != 0.0, "else the frames of the world and of its start would be one"
    series = {look.name: look.errors for look in measure_detections(0, 6)}
    assert set(series) == {"marker_still", "dock_still", "marker_moving", "dock_moving"}
    for name, errors in series.items():
        assert len(errors) >= 4, name
        assert np.abs(errors[:, :2]).max() < (5.0 if "still" in name else 15.0), name  # millimetres
        assert np.abs(errors[:, 2]).max() < 3.0, name  # degrees
        assert np.abs(errors).max() > 1e-3, "there is noise"


@pytest.mark.parametrize("dock", ["charger_v", "charger_r"])
def test_scanners_see_docks_where_they_are(dock: str) -> None:
    assert load_world("dock_shapes").start.yaw != 0.0
    series = {look.name: look.errors for look in measure_scan_detections(0, 4, "dock_shapes", "amr_omni", dock, {})}
    assert {"dock_still", "dock_moving"} <= set(series)
    for name, errors in series.items():
        assert np.abs(errors[:, :2]).max() < 30.0, name
        assert np.abs(errors[:, 2]).max() < 4.0, name
