"""The commands of README and docs: all parse, the quick ones run as they stand, runs of robots are ended early, and the others say why they do not run."""

import argparse
import re
from pathlib import Path

import pytest

from ambler.cli.main import build_parser, main
from tests.docs import stand_ins
from tests.docs.commands import ROOT, Command, block_commands, mentioned_commands
from tests.docs.example_recording import MADE_ON, processor

DATA = "needs public recordings (docs/datasets.md)"
WHOLE_RUN = "a whole run of a robot; tests/apps and tests/scenarios drive such"
ON_A_SITE = "a whole run on a site, whose meshes alone take half a minute; tests/scenarios drive such"
STUDY = "minutes to hours of runs"
OWN_FILES = "needs files that only its reader has"
QUICK = (
    "slam2d examples/lab_empty/recording --odom-topic /odom --out runs/lab_map",
    "localize examples/lab_empty/recording --odom-topic /odom --map examples/lab_empty/map.yaml",
    "localize examples/lab_empty/recording --odom-topic /odom --map examples/lab_empty/map.yaml --out runs/lab_poses",
    "replay examples/lab_empty --out runs/lab_replay",
    "replay runs/LATEST",
    "animate runs/LATEST",
    "demo --world lab_empty --start 2,2,-45 --exit --no-view",
    "slam2d log.clf.gz --out map_folder",
    "slam2d log.clf.bz2 --out my_map",
    "slam2d log.clf.bz2 --out my_map --relations log.relations --json result.json",
    "bench slam2d",
    "config show --robot spot",
    "config explain rollout.horizon",
    "config explain gate.reaction_time",
    "config check slow.yaml",
    "world generate office --seed 17 --out office.yaml --picture office.png",
    "world generate office --seed 17 --day 2 --out later.yaml",
    "world show campus --picture campus.png",
    "world show garage --picture ground_floor.png --cut 2.5",
    "world generate site --seed 17 --out site.yaml",
    "calibrate range --simulated --out robot.yaml",
)
SHORTENED = (
    "demo",
    "demo --robot spot --world lab_obstacle --seed 3",
    "demo --world office-17",
    "demo --world office-17 --set global_planner=visibility_graph",
    "demo --robot porter+depth --world office",
    "demo --profile slow.yaml --set planner.factor=1.2",
    "demo --world building --robot amr_omni --then dock:charger_1 --then undock:charger_1 --then 3,0,90",
    "demo --world glass --robot diff+ultrasonic",
    "navigate 10,0 --world office --lost --may-turn",
    "navigate --unknown --planner visibility_graph --world office-17 -- 5.4,7",
    "navigate --unknown --world office-17 -- 5.4,7",
    "navigate --world office --robot diff --set controller=primitives -- 4,0 8,3",
    "dock charger_1 --world dock_room",
    "dock charger_1 --world dock_hall",
    "dock charger_1 --world dock_hall --then-undock",
    "dock charger_v --world dock_shapes",
    "dock charger_1 --fault shadow --fault blur",
    "dock charger_1 --imperfections drawn --seed 3",
    "dock charger_1 --profile slow.yaml",
    "undock charger_1",
    "demo --world lab_empty --robot spot --set odometry_source=lidar",
    "demo --world my_floor_plan.yaml",
    "demo --profile studies/paths/best.yaml",
)
NOT_RUN = {
    "dock charger_1 --teach --docks docks.yaml": OWN_FILES,
    "demo --robot go2 --world garage --then 20,0@1 --then 14,0@0": ON_A_SITE,
    "demo --robot go2 --world campus --drive built-in": ON_A_SITE,
    "demo --robot go2 --world campus": ON_A_SITE,
    "demo --robot mecanum --world plot-17": ON_A_SITE,
    "demo --robot go2 --world garage": ON_A_SITE,
    "demo --robot go2 --world plot-1 --stations 8": ON_A_SITE,
    "demo --robot go2 --world plot-17": ON_A_SITE,
    "demo --robot mecanum --world garage --drive built-in --speed 1.0 --seed 3": ON_A_SITE,
    "demo --robot go2 --world campus --drive built-in --fault dust@30": ON_A_SITE,
    "demo --robot mecanum --world campus --drive built-in": ON_A_SITE,
    "demo --world lab_empty --apart": WHOLE_RUN,
    "bench terrain --runs 200 --json terrain.json": "tests/studies/test_ground_study.py measures a few clouds",
    "bench far --json docs/results/bench_far.json": "a minute; tests/planning looks at the graph",
    "bench odometry": "a minute of a drive; tests/studies measures a short one",
    "calibrate --simulated --robot amr_omni --out check.yaml": WHOLE_RUN,
    "eval exploration --worlds lab_empty --robots diff --runs 5 --json summary.json": STUDY,
    "eval exploration --worlds lab_empty --robots diff --runs 9": STUDY,
    "eval exploration --worlds office --seed draw --runs 3": STUDY,
    "eval exploration --worlds office --processes 4": STUDY,
    "eval crowd --runs 30 --people 10 --seed draw --json crowd.json": STUDY,
    "eval crowd --worlds office --robots diff --runs 2 --people 4 --stubborn 4": STUDY,
    "eval glass --json glass.json": STUDY,
    "navigate --world office-17 --planner visibility_graph --map runs/LATEST/map.yaml -- 5.4,7": WHOLE_RUN,
    "eval overhangs --seed draw --runs 10 --json docs/results/overhangs.json": STUDY,
    "bench live --robot go2 --world plot-1 --seconds 60 --json live.json": WHOLE_RUN,
    "eval sites --seed draw --runs 4 --json sites.json": STUDY,
    "navigate --robot go2 --world plot-17 --map runs/LATEST --lost --may-turn --start 12,30,90 -- 5,5 20,-8,180": WHOLE_RUN,
    "navigate --robot go2 --world garage --map runs/LATEST --lost --may-turn -- 12,4@1": WHOLE_RUN,
    "eval return --kinds plot --robots go2 --seed draw --runs 10 --json return.json": STUDY,
    "lio runs/LATEST/recording --truth runs/LATEST/truth.tum --out my_map": "needs a drive; tests/apps/test_drive.py maps one",
    "eval unknown --kinematic --runs 20 --seed draw --json docs/results/unknown.json": STUDY,
    "dock charger_1 --camera camera.yaml": WHOLE_RUN,
    "slam2d my_bag --out my_map --scan-topic /front/scan": OWN_FILES,
    "lio my_walk --out my_map": OWN_FILES,
    "lio my_walk --out my_map --truth truth.tum --json walk.json": OWN_FILES,
    "lio my_clouds --no-imu --out my_map": OWN_FILES,
    "lio my_walk --map my_map/cloud.pcd --out my_place": OWN_FILES,
    "lio my_walk --map my_map/cloud.pcd --guess 1.5,-2,0,90 --out my_place": OWN_FILES,
    "lio my_walk --grid --out my_map": OWN_FILES,
    "eval lio --kinds dust,smoke,rain --lidars mid_360 --seed draw": STUDY,
    "demo --robot go2 --world campus --drive route.yaml --map my_map/cloud.pcd": WHOLE_RUN,
    "bench lio": "beside kiss-icp a minute; tests/lio drives the filter",
    "calibrate camera 'board_*.png' --board 7x5 --square 0.04 --out camera.yaml": OWN_FILES,
    "calibrate RECORDING --robot amr_omni --out robot.yaml": OWN_FILES,
    "tune space.yaml --out studies/paths --processes 2": STUDY,
    "calibrate range near.png@0.50 far.png@2.00 mid.png@1.00 more.png@1.50 last.png@1.75 --camera camera.yaml "
    "--marker 4X4_50:3:0.15 --out robot.yaml": OWN_FILES,
    "calibrate reflectors --survey RECORDING --robot diff --out robot.yaml": OWN_FILES,
    "eval docking --imperfections exact --runs 60 --fault-runs 20 --json docs/results/docking.json": STUDY,
    "eval docking --world dock_room --only random --runs 100 --seed draw --json docs/results/docking_drawn.json": STUDY,
    "eval docking --world dock_shapes --dock charger_v": STUDY,
    "eval faults --json faults.json": STUDY,
    "eval faults --only people,glass --runs 5": STUDY,
    "eval faults --runs 2": STUDY,
    "eval exploration --worlds lab_empty --runs 40 --cluster tcp://127.0.0.1:8786": STUDY,
    "eval ground --seed draw --runs 10 --json ground.json": STUDY,
    "bench posegraph": DATA,
    "bench exploration": DATA,
}
LIMITS = {"--exit": (), "--no-view": (), "--time-limit": ("2",)}
"""What is added to a shortened command where its verb knows it: nobody watches, and the robot runs for two seconds of its time."""


SAYS = {
    "slam2d examples/": r"(99|100)\.\d % of the returns on walls",
    "slam2d log.clf.bz2 --out my_map --relations": r"relations: 1 used, translation 0\.\d+",
    "localize": r"times_lost +0\b",
    "world generate office": r"office-17(-day2)?: 31 x 20 m, \d+ m² that a robot reaches",
    "replay": r"/slam_pose +(\d{3}) of \1 equal",
    "demo --world lab_empty --start": r"ended +│ finished",
    "config explain gate.reaction_time": r"gate\.reaction_time",
}
"""What a command that begins so prints."""
BLOCKS = {str(command): command for command in block_commands()}


def sub_parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of a verb's sub-verbs by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def parser_of(command: Command) -> argparse.ArgumentParser:
    """Return the parser of a command's verb and sub-verb."""
    parser = build_parser()
    for word in command.words:
        if word == "…" or not (choices := sub_parsers(parser)):
            break
        if word not in choices and parser.prog.endswith("calibrate"):
            break
        parser = choices[word]
    return parser


@pytest.mark.parametrize("command", BLOCKS.values(), ids=str)
def test_commands_in_blocks_parse(command: Command) -> None:
    build_parser().parse_args(command.words)


@pytest.mark.parametrize("command", sorted(set(mentioned_commands()), key=str), ids=str)
def test_mentioned_commands_have_the_options_that_are_named(command: Command) -> None:
    options = parser_of(command)._option_string_actions
    named = [word.strip("[]") for word in command.words if word.strip("[").startswith("--")]
    assert [name for name in named if name not in options] == []


def test_every_command_runs_here_or_has_a_reason_not_to() -> None:
    on_public_data = [text for text in BLOCKS if "$AMBLER_DATA" in text]
    assert sorted([*QUICK, *SHORTENED, *NOT_RUN, *on_public_data]) == sorted(BLOCKS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with the files that the commands name."""
    path = tmp_path_factory.mktemp("documents")
    stand_ins.make(path)
    return path


@pytest.mark.parametrize("text", QUICK)
def test_quick_commands_run(
    text: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    code = main(list(BLOCKS[text].words))
    # On the processor that it was made on the recording gives the same bits. When a node was changed on purpose: tests.docs.example_recording.
    is_elsewhere = text.startswith("replay") and MADE_ON.read_text(encoding="utf-8").strip() != processor()
    # Covariances come from LAPACK, whose kernel the environment may choose: their last bits alone may differ, which ends with 1. Poses may not.
    assert code == 0 or (code == 1 and text.startswith("replay"))
    printed = capsys.readouterr().out
    assert printed.strip()
    for start, said in SAYS.items():
        assert is_elsewhere or not text.startswith(start) or re.search(said, printed)


def shortened(command: Command) -> list[str]:
    """Return the words of a command with those limits that its verb knows."""
    known = parser_of(command)._option_string_actions
    limits = [word for name, values in LIMITS.items() if name in known for word in (name, *values)]
    words = list(command.words)
    end = words.index("--") if "--" in words else len(words)
    return [*words[:end], *limits, *words[end:]]


@pytest.mark.parametrize("text", SHORTENED)
def test_shortened_commands_run(
    text: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the document says it, but ended after two seconds: everything that it names exists, the robot starts and drives, and a report is written."""
    monkeypatch.chdir(folder)
    code = main(shortened(BLOCKS[text]))
    printed = capsys.readouterr().out
    assert code == 0 or (code == 1 and "the time limit of 2 s is over" in printed)
    report = re.search(r"report: (\S+)", printed)
    assert report is not None
    assert (folder / report[1]).stat().st_size > 10_000


def test_the_small_recording_is_small() -> None:
    files = [path for path in (ROOT / "examples" / "lab_empty").rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 2_000_000
