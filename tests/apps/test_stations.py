"""Stations of a simulated robot: where the option is refused, which nodes it adds, and a short run that saves and judges one."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import pytest

from ambler.apps.config import RobotConfig, robot_config
from ambler.apps.replay import replay_run
from ambler.apps.robot import Site, robot_nodes
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions, checked_scene
from ambler.apps.simulated import operator_config
from ambler.cli.demo import add_parser
from ambler.cli.main import main
from ambler.cli.run_options import options_of
from ambler.core.errors import BadInputError
from ambler.lio.config import LioConfig, LoopConfig
from ambler.nodes.explorer import ExplorerNode
from ambler.nodes.stations import StationNode
from ambler.nodes.steps import ExploreStep
from ambler.runtime.tasks import SAVE_STATIONS, SCAN_STATION
from ambler.sim.robots import robot_named
from ambler.wire.station_files import load_stations


def options(*words: str) -> RunOptions:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    return options_of(parser.parse_args(["demo", *words]), (ExploreStep(),))


def test_without_the_option_nothing_of_it_is_there(tmp_path: Path) -> None:
    config = checked_scene(options("--world", "ramp", "--robot", "go2")).config
    go2 = robot_named("go2").model
    nodes = robot_nodes(go2, config, Site())
    assert config.explore.stations.spacing == 0.0
    assert not any(isinstance(node, StationNode) for node in nodes)
    assert SCAN_STATION not in next(node for node in nodes if isinstance(node, ExplorerNode)).calls
    assert SAVE_STATIONS not in operator_config(options(), config, go2, RunFolder(tmp_path / "run")).saves_with


def test_with_it_they_are_collected_and_saved_with_the_map(tmp_path: Path) -> None:
    wanted = options("--world", "ramp", "--robot", "go2", "--stations", "6")
    config = checked_scene(wanted).config
    go2 = robot_named("go2").model
    nodes = robot_nodes(go2, config, Site())
    assert config.explore.stations.spacing == 6.0
    assert sum(isinstance(node, StationNode) for node in nodes) == 1
    assert SCAN_STATION in next(node for node in nodes if isinstance(node, ExplorerNode)).calls
    assert operator_config(wanted, config, go2, RunFolder(tmp_path / "run")).saves_with[-1] == SAVE_STATIONS


@pytest.mark.parametrize(("world", "robot"), [("office", "go2"), ("office", "diff"), ("ramp", "diff")])
def test_a_robot_that_maps_a_level_floor_is_refused(world: str, robot: str) -> None:
    with pytest.raises(BadInputError, match="map of ground and loop closure"):
        checked_scene(options("--world", world, "--robot", robot, "--stations", "5"))


def test_so_is_one_that_closes_no_loops() -> None:
    config = checked_scene(options("--world", "ramp", "--robot", "go2", "--stations", "6")).config
    open_ended = replace(config, lio=replace(LioConfig(), loops=LoopConfig(is_used=False)))
    with pytest.raises(BadInputError, match="loop closure"):
        robot_nodes(robot_named("go2").model, open_ended, Site())
    assert isinstance(robot_config(robot_named("go2").model, {}), RobotConfig)


@pytest.mark.parametrize("words", [("--stations", "0"), ("--stations=-3",), ("--stations", "nan")])
def test_nonsense_is_one_clear_error(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--world", "ramp", "--robot", "go2", *words, "--no-view", "--exit"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "--stations" in line


def test_too_near_is_refused_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--world", "ramp", "--robot", "go2", "--stations", "0.2", "--no-view", "--exit"]) == 2
    assert "stations spacing: 0 (none) or at least 1 m" in capsys.readouterr().err


def test_a_drive_along_a_route_has_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--world", "campus", "--drive", "built-in", "--stations", "9", "--no-view", "--exit"]) == 2
    assert "--stations belongs to an exploration" in capsys.readouterr().err


def test_a_robot_holds_still_saves_what_it_saw_and_is_judged(tmp_path: Path) -> None:
    """Some seconds of an exploration: a station, its files, its numbers; and a replay that is equal."""
    result = tmp_path / "result.json"
    words = ["demo", "--world", "ramp", "--robot", "mecanum", "--kinematic", "--exit", "--no-view", "--stations", "20"]
    more = ["--time-limit", "11", "--set", "explore.stations.hold=3", "--out", str(tmp_path / "runs")]
    main([*words, *more, "--json", str(result)])
    told = json.loads(result.read_text())
    assert told["ended"] == "time_limit"
    assert told["collisions"] == 0
    assert told["stations"] == 1
    assert told["station_seconds_median"] == pytest.approx(3.0, abs=0.1)
    assert told["station_ratio_vs_one_scan_median"] > 10.0
    assert told["station_at_truth_surface_median_m"] < 0.015
    assert told["station_surface_median_m"] < 0.05
    (run,) = (tmp_path / "runs").glob("2*")
    (station,) = load_stations(run / "map")
    assert len(station.points) == told["station_points_median"]
    codes = [json.loads(line)["code"] for line in (run / "log.jsonl").read_text().splitlines()]
    assert codes.count("SCANNING") == codes.count("STATION_DONE") == 1
    assert codes.index("SCANNING") < codes.index("STATION_DONE")
    assert "DRIVING" in codes[codes.index("STATION_DONE") :]
    assert replay_run(run).is_good
