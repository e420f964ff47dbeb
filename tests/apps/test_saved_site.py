"""A site that was explored is saved, and driven in by another run that is not told where it begins; what is not whole is refused before anything runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.config import robot_config
from ambler.apps.replay import replay_run
from ambler.apps.robot import Site, robot_nodes
from ambler.apps.run_folder import RunFolder
from ambler.apps.saved_site import check_places, is_site, load_site
from ambler.apps.scene import RunOptions, checked_scene
from ambler.apps.simulated import SimulatedRun
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.se2 import SE2
from ambler.nodes.navigator import NavigatorNode
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.steps import NavigateStep
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.runtime.tasks import CHOOSE_LEVEL
from ambler.sim.robots import robot_named
from ambler.wire.cloud_files import write_cloud
from ambler.wire.graph_files import save_graph
from ambler.wire.ground_files import load_levels, save_levels
from ambler.wire.map_files import save_map

GROUND = {"odometry_source": "lidar", "mapping": "ground"}


def saved_by_hand(folder: Path, *, has_cloud: bool = True) -> Path:
    """A room of 20 m by 10 m on a slope, with walls."""
    spec = GridSpec(0.1, 200, 100, -10.0, -5.0)
    occupancy = np.zeros(spec.shape, np.int8)
    occupancy[:, 0] = occupancy[:, -1] = occupancy[0] = occupancy[-1] = 100
    heights = np.tile(0.05 * (spec.origin_x + 0.1 * np.arange(200)), (100, 1)).astype(np.float32)
    save_map(folder / "map", spec, occupancy)
    save_levels(folder / "map", [(spec, occupancy, heights)])
    if has_cloud:
        along, up = np.meshgrid(np.arange(-10.0, 10.0, 0.1), np.arange(0.0, 3.0, 0.1))
        walls = [np.column_stack([along.ravel(), np.full(along.size, y), up.ravel()]) for y in (-5.0, 5.0)]
        walls += [np.column_stack([np.full(along.size, x), 0.5 * along.ravel(), up.ravel()]) for x in (-10.0, 10.0)]
        floor = np.array([[x, y, 0.05 * x] for x in np.arange(-10, 10, 0.2) for y in np.arange(-5, 5, 0.2)])
        write_cloud(folder / "map.cloud.pcd", np.concatenate([*walls, floor]).astype(np.float32))
    return folder / "map.yaml"


def test_a_robot_that_can_drives_on_the_ground_of_a_saved_site_and_others_on_its_plan(tmp_path):
    file = saved_by_hand(tmp_path)
    assert is_site(file)
    steps = (NavigateStep(SE2(3.0, 1.0, 0.0)), NavigateStep(SE2(-3.0, 1.0, 0.0), level=0))
    scene = checked_scene(RunOptions(steps, world="ramp", robot="go2", map_file=file))
    assert scene.grid is None
    assert scene.site is not None
    assert (scene.config.mapping, scene.config.odometry_source) == ("ground", "lidar")
    go2 = robot_named("go2").model
    assert scene.config.gate_for(go2).slope > 0.3
    stack = robot_nodes(go2, scene.config, Site(saved=scene.site))
    nodes = {node.name for node in stack}
    assert any(CHOOSE_LEVEL in node.calls for node in stack if isinstance(node, NavigatorNode))
    assert {"ground_server", "localization", "navigator", "terrain"} <= nodes
    assert not {"ground_mapper", "slam2d", "explorer", "map_server"} & nodes
    plain = checked_scene(RunOptions(steps[:1], world="lab_empty", robot="diff", map_file=file))
    assert plain.site is None
    assert plain.grid is not None


def test_where_it_starts_is_told_with_the_height_of_the_ground(tmp_path):
    site = load_site(saved_by_hand(tmp_path))
    config = robot_config(robot_named("go2").model, GROUND, has_map=True)
    assert config.controller == "rollout"
    assert site.ground().standing_at(SE2(4.0, 1.0, 0.3)).translation == pytest.approx((4.0, 1.0, 0.2), abs=0.01)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": SE2(30.0, 0.0, 0.0)}, "start pose 30, 0 m does not lie on its ground"),
        ({"steps": (NavigateStep(SE2(30.0, 0.0, 0.0)),)}, "goal 30, 0 m lies outside"),
        ({"steps": (NavigateStep(SE2(1.0, 0.0, 0.0), level=1),)}, "has no level 1"),
    ],
)
def test_places_outside_are_refused(tmp_path, options, message):
    told = {"steps": (NavigateStep(SE2(1.0, 0.0, 0.0)),), "world": "ramp", "robot": "go2", **options}
    with pytest.raises(BadInputError, match=message):
        checked_scene(RunOptions(map_file=saved_by_hand(tmp_path), **told))


def test_a_start_that_is_not_told_may_lie_anywhere(tmp_path):
    steps = (NavigateStep(SE2(1.0, 0.0, 0.0)),)
    scene = checked_scene(
        RunOptions(
            steps, world="ramp", robot="go2", map_file=saved_by_hand(tmp_path), start=SE2(3.0, 0.0), is_lost=True
        )
    )
    assert scene.config.localization.initial_pose is None
    check_places(scene.site, None, [], "")


def test_a_site_without_its_cloud_and_levels_elsewhere_are_refused(tmp_path):
    steps = (NavigateStep(SE2(1.0, 0.0, 0.0)),)
    with pytest.raises(BadInputError, match=r"map\.cloud\.pcd: is missing"):
        checked_scene(RunOptions(steps, world="ramp", robot="go2", map_file=saved_by_hand(tmp_path, has_cloud=False)))
    with pytest.raises(BadInputError, match="needs a map of ground"):
        checked_scene(RunOptions((NavigateStep(SE2(1.0, 0.0, 0.0), level=0),), world="office", robot="diff"))
    with pytest.raises(BadInputError, match="levels and a cloud"):
        checked_scene(RunOptions(steps, world="ramp", robot="go2", profile=GROUND))


def test_the_graph_that_was_saved_with_a_site_is_gone_on_with(tmp_path):
    file = saved_by_hand(tmp_path)
    spec, walls, _ = load_levels(tmp_path / "map.levels.npz")[0]
    costs = np.where(walls == 100, COST_LETHAL, 0).astype(np.uint8)
    costs[40:80, 90:110] = COST_LETHAL
    planner = VisibilityPlanner()
    planner.plan(costs, spec, SE2(-4.0, 0.5), SE2(4.0, 0.5))
    save_graph(tmp_path / "map.vgraph", planner.to_arrays())
    options = RunOptions(
        (NavigateStep(SE2(3.0, 1.0, 0.0)),),
        world="ramp",
        robot="go2",
        map_file=file,
        physics="kinematic",
        port=None,
        profile={"global_planner": "visibility_graph"},
    )
    run = SimulatedRun(options, RunFolder(tmp_path / "run"))
    run.close()
    node = run.robot.stack.node("planner")
    assert isinstance(node, GlobalPlannerNode)
    assert isinstance(node.planner, VisibilityPlanner)
    assert planner.graph.node_count >= 4
    np.testing.assert_array_equal(node.planner.to_arrays()["ident"], planner.to_arrays()["ident"])


def test_explored_saved_found_again_and_replayed(tmp_path):
    """Some seconds of an exploration, then another run that begins elsewhere and knows so about: it finds its place in the cloud and drives to a place of the map; its replay gives the same bits.
    Told nothing, it would not move: half of the yard looks like the other half turned about."""
    common = ["--world", "ramp", "--robot", "mecanum", "--kinematic", "--exit", "--no-view"]
    common += ["--set", "global_planner=visibility_graph"]
    main(["demo", *common, "--time-limit", "16", "--out", str(tmp_path / "first")])
    (first,) = (tmp_path / "first").glob("2*")
    assert {"map.yaml", "map.levels.npz", "map.cloud.pcd", "map.vgraph"} <= {file.name for file in first.iterdir()}
    result = tmp_path / "result.json"
    words = ["navigate", *common, "--map", str(first), "--start=0.6,0.4,25", "--seed", "3"]
    words += ["--time-limit", "60", "--out", str(tmp_path / "second"), "--json", str(result), "--", "-0.6,-0.8@0"]
    assert main(words) == 0
    told = json.loads(result.read_text())
    assert (told["ended"], told["goals_reached"], told["collisions"]) == ("succeeded", 1, 0)
    assert told["localizer"] == "cloud"
    assert told["position_error_max_m"] < 0.2
    (second,) = (tmp_path / "second").glob("2*")
    assert replay_run(second, tmp_path / "again").is_good
