"""The grid tracker in a map that SLAM made: walls that another visit drew nearer must not shut it out for good."""

from __future__ import annotations

import numpy as np

from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Observation
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms

NEARER = 0.1  # metres by which everything from x = 14 m on is drawn nearer, as by a visit that saw it from another pose


def hallway(nearer: float) -> rooms.Room:
    """A hallway with pillars."""
    pillars = []
    for k in range(9):
        side = 0.3 + (2.0 * nearer if k >= 4 else 0.0)
        pillars.append(rooms.box(2.0 + 3.1 * k, 0.1 + 2.3 * (k % 2), side, side))
    walls = [rooms.box(21.0, y, 14.0, nearer) for y in (0.5 * nearer, 2.5 - 0.5 * nearer)] if nearer else []
    return rooms.Room("hallway", (28.0, 2.5), (*pillars, *walls))


def test_a_map_whose_walls_come_nearer_somewhere_is_believed_again() -> None:
    cells, spec = hallway(NEARER).occupancy()
    tracker = GridTracker(SurfaceMap.from_occupancy(cells, spec), GridTrackerConfig())
    lost = 0
    for k, step in enumerate(rooms.drive(hallway(0.0), [(1.0, 1.25), (26.0, 1.25)], np.random.default_rng(4))):
        if k == 0:
            tracker.set_pose(step.stamp_ns, step.odom_from_base, step.truth, np.diag([0.01, 0.01, 0.003]))
        estimate = tracker.update(Observation(step.stamp_ns, step.odom_from_base, step.points_base))
        lost = 0 if estimate.is_updated else lost + 1
        assert lost < 10, f"at {step.truth.x:.1f} m no match is believed any more"
        assert np.hypot(*rooms.error_of(estimate.map_from_base, step.truth)[:2]) < 0.15
    assert estimate.covariance[0, 0] < 0.05**2
