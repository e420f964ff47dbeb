"""Where a robot may begin: what it cannot begin in is told before anything runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.apps.scene import RunOptions, checked_scene
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.nodes.steps import ExploreStep, NavigateStep
from ambler.sim.robots import robot_named
from ambler.sim.truth import truth_grid
from ambler.sim.world_file import load_world


@pytest.mark.parametrize(
    ("robot", "yaw", "fits"),
    [("diff", 0.0, True), ("diff", 1.57, True), ("spot", 0.0, True), ("spot", 1.57, False), ("amr_omni", 1.57, False)],
)
def test_a_robot_that_does_not_fit_its_start_is_refused(robot: str, yaw: float, *, fits: bool) -> None:
    """Half a metre beside the wall of an empty room a long robot stands along it, and not across."""
    half_length = robot_named(robot).model.footprint[:, 0].max()
    assert (half_length < 0.5) == (robot == "diff")
    options = RunOptions(world="lab_empty", robot=robot, start=beside_the_wall(0.45, yaw))
    if fits:
        checked_scene(options)
        return
    with pytest.raises(BadInputError, match=f"{robot} does not fit at its start: something stands at"):
        checked_scene(options)


def beside_the_wall(gap: float, yaw: float) -> SE2:
    """A pose so far from the wall on the right of the start."""
    y = 0.0
    while True:
        try:
            checked_scene(RunOptions(world="lab_empty", robot="diff", start=SE2(0.0, y)))
        except BadInputError:
            return SE2(0.0, y + gap - robot_named("diff").model.footprint[:, 1].max(), yaw)
        y -= 0.05


@pytest.mark.parametrize(("floor", "fits"), [(0, True), (10, True), (49, True), (50, False)])
def test_the_start_may_lie_on_the_floor_of_a_graded_map(tmp_path: Path, floor: int, *, fits: bool) -> None:
    spec, cells = truth_grid(load_world("lab_empty").from_start(), 0.18, 0.05)
    pixels = np.where(cells == 0, floor, np.where(cells < 0, 255, 100)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "m.png"), pixels[::-1])
    (tmp_path / "m.yaml").write_text(
        f"image: m.png\nmode: raw\nresolution: 0.05\norigin: [{spec.origin_x}, {spec.origin_y}, 0]\n"
    )
    steps = (NavigateStep(SE2(0.5, 0.0, 0.0)),)
    options = RunOptions(steps, world="lab_empty", robot="diff", map_file=tmp_path / "m.yaml")
    if fits:
        checked_scene(options)
        return
    with pytest.raises(BadInputError, match="does not lie on its free floor"):
        checked_scene(options)


@pytest.mark.parametrize("given", ["m.yaml", "m.png"])
def test_the_plan_of_a_world_is_no_map_of_it(tmp_path: Path, given: str) -> None:
    """Its places count from another origin than the robot's start: a robot had driven 1.5 m beside its goals, and told success."""
    spec, cells = truth_grid(load_world("lab_empty").from_start(), 0.18, 0.05)
    cv2.imwrite(str(tmp_path / "m.png"), np.where(cells == 0, 254, np.where(cells < 0, 205, 0)).astype(np.uint8)[::-1])
    (tmp_path / "m.yaml").write_text(
        f"image: m.png\nresolution: 0.05\norigin: [{spec.origin_x}, {spec.origin_y}, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    options = RunOptions((NavigateStep(SE2(0.5, 0.0, 0.0)),), world=str(tmp_path / given), robot="diff")
    assert checked_scene(options).grid is not None
    with pytest.raises(BadInputError, match="is the plan of the world itself"):
        checked_scene(replace(options, map_file=tmp_path / "m.yaml"))


@pytest.mark.parametrize(
    ("x", "y", "says"),
    [
        (1.5, 0.5, None),
        (0.5, 0.0, None),  # a cell that the beams missed
        (3.5, 0.0, "not on a free cell"),  # seen by nobody
        (50.0, 0.0, "not on a free cell"),
    ],
)
def test_a_robot_starts_on_the_floor_of_a_plan(tmp_path: Path, x: float, y: float, says: str | None) -> None:
    """Nothing fills the grey around a saved map: a robot put there had driven about in it, and nothing was said."""
    pixels = np.full((200, 200), 205, np.uint8)
    pixels[69:132, 69:132], pixels[70:131, 70:131] = 0, 254
    pixels[98:103, 108:113] = 205
    cv2.imwrite(str(tmp_path / "m.pgm"), pixels)
    (tmp_path / "m.yaml").write_text("image: m.pgm\nresolution: 0.05\norigin: [-3, 2, 0]\n")
    for steps in ((ExploreStep(),), (NavigateStep(SE2(1.0, 0.0, 0.0)),)):
        options = RunOptions(steps, world=str(tmp_path / "m.yaml"), robot="diff", start=SE2(x, y), is_lost=True)
        if says is None:
            checked_scene(options)
            continue
        with pytest.raises(BadInputError, match=says):
            checked_scene(options)


def test_a_start_far_from_everything_is_not_called_a_solid() -> None:
    with pytest.raises(BadInputError, match="lies outside of all that stands in it"):
        checked_scene(RunOptions(world="lab_empty", robot="diff", start=SE2(100.0, 0.0)))
