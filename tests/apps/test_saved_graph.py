"""A visibility graph that is saved with the map of one run, and gone on with by the next one that loads that map; its replay is equal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.steps import NavigateStep
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.wire.graph_files import load_graph

WORDS = ["navigate", "--world", "lab_obstacle", "--robot", "diff", "--kinematic", "--exit", "--no-view"]
PLANNER = ["--planner", "visibility_graph"]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map that a drive through an unknown place left, with the graph beside it."""
    out = tmp_path_factory.mktemp("unknown")
    assert main([*WORDS, *PLANNER, "--unknown", "--out", str(out), "--", "1.5,0.5"]) == 0
    (found,) = out.glob("2*/map.yaml")
    return found


def planner_of(run: SimulatedRun) -> VisibilityPlanner:
    node = run.robot.stack.node("planner")
    assert isinstance(node, GlobalPlannerNode)
    assert isinstance(node.planner, VisibilityPlanner)
    return node.planner


def options(map_file: Path, planner: str = "visibility_graph") -> RunOptions:
    steps = (NavigateStep(SE2(1.0, -0.5, 0.0)),)
    return RunOptions(
        steps,
        "lab_obstacle",
        "diff",
        map_file=map_file,
        physics="kinematic",
        port=None,
        profile={"global_planner": planner},
    )


def test_a_run_that_loads_the_map_goes_on_with_its_graph(mapped: Path, tmp_path: Path) -> None:
    saved = load_graph(mapped.with_suffix(".vgraph"))
    assert saved["is_alive"].sum() > 3
    run = SimulatedRun(options(mapped), RunFolder(tmp_path / "run"))
    try:
        np.testing.assert_array_equal(planner_of(run).to_arrays()["ident"], saved["ident"])
        run.run(60.0)
        assert run.ended == "succeeded"
    finally:
        run.close()
    assert replay_run(tmp_path / "run").is_good, "the replay begins with that graph, too"


def test_a_map_without_a_graph_and_a_planner_without_one_begin_anew(mapped: Path, tmp_path: Path) -> None:
    for name in ("map.yaml", "map.pgm"):
        (tmp_path / name).write_bytes((mapped.parent / name).read_bytes())
    run = SimulatedRun(options(tmp_path / "map.yaml"), RunFolder(tmp_path / "bare"))
    run.close()
    assert planner_of(run).graph.node_count == 0
    (tmp_path / "map.vgraph").write_bytes(b"no graph")
    SimulatedRun(options(tmp_path / "map.yaml", "grid"), RunFolder(tmp_path / "grid")).close()
    with pytest.raises(BadInputError, match=r"map\.vgraph"):
        SimulatedRun(options(tmp_path / "map.yaml"), RunFolder(tmp_path / "broken"))


def test_a_run_with_the_grid_planner_saves_no_graph(tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    words = [*WORDS, "--unknown", "--out", str(tmp_path), "--json", str(result), "--", "0.5,0"]
    assert main(words) == 0
    assert json.loads(result.read_text())["goals_reached"] == 1
    assert not list(tmp_path.glob("2*/*.vgraph"))
