"""A tall robot among tables, signs and open drawers: its planar scanner alone lets it hit them, its depth camera does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.sim.robots import robot_named
from ambler.studies import overhang_study
from ambler.studies.made_overhangs import LEAST_WAY, draw_goals, room_world
from ambler.studies.overhang_study import OverhangCase, run_case, summarize

SEED = 901


def test_with_depth_cameras_nothing_is_touched_and_without_them_something_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overhang_study, "GOALS", 2)
    monkeypatch.setattr(overhang_study, "SECONDS_PER_GOAL", 25.0)
    results = []
    for voxels in overhang_study.VOXELS:
        case = OverhangCase(SEED, "porter+depth", voxels, "kinematic")
        results.append({**run_case(case, tmp_path), "voxels": voxels})
    fields = summarize(results)
    assert (fields["with_voxels.reached"], fields["with_voxels.collisions"]) == (2, 0)
    assert fields["without.runs_with_collision"] == 1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_goal_lies_behind_something_that_hangs_and_the_robot_fits_there(seed: int) -> None:
    robot, world = robot_named("porter"), room_world(seed).from_start()
    tops = [s for s in world.solids if s.z_max < 2.0]
    at = np.zeros(2)
    for goal in draw_goals(seed, robot, 4):
        end = np.array([goal.x, goal.y])
        line = np.linspace(at, end, 400)
        crossed, nearest = False, np.inf
        for solid in tops:
            local = np.abs(solid.world_from_solid.inverse().transform(np.vstack([line, end])))
            beside = np.hypot(*np.maximum(local - 0.5 * np.array([solid.size_x, solid.size_y]), 0.0).T)
            crossed |= bool((beside[:-1] < 0.03).any())
            nearest = min(nearest, float(beside[-1]))
        assert crossed
        assert nearest > robot.model.circumscribed_radius + 0.15
        assert np.hypot(*(end - at)) >= LEAST_WAY - 0.05
        at = end


def test_a_robot_that_nobody_knows_is_refused_before_anything_runs() -> None:
    with pytest.raises(BadInputError, match="no robot"):
        overhang_study.overhang_study([1], "tower")
