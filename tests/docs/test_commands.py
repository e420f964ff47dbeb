"""The commands of README and docs: all parse, the quick ones run as they stand, runs of robots are ended early, the long ones run in `test_long_commands`, and the others say why they do not run."""

import re
from pathlib import Path

import pytest

from ambler.cli.main import build_parser, main
from tests.docs import stand_ins
from tests.docs.commands import BLOCKS, ROOT, Command, lengthened, mentioned_commands, parser_of
from tests.docs.example_recording import MADE_ON, processor
from tests.docs.long_commands import LONG

EXPLORED = "its goals need a whole exploration of the site; `eval return` in LONG comes back to a part of one"
DATA = "needs public recordings (docs/datasets.md)"
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
    "demo --robot porter+depth --world office",
    "demo --profile slow.yaml --set planner.factor=1.2",
    "demo --world building --robot amr_omni --then dock:charger_1 --then undock:charger_1 --then 3,0,90",
    "demo --world glass --robot diff+ultrasonic",
    "navigate 10,0 --world office --lost --may-turn",
    "navigate --unknown --planner visibility_graph --world office-17 -- -5.6,9.4",
    "navigate --unknown --world office-17 -- -5.6,9.4",
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
)
NOT_RUN = {
    "demo --robot go2 --world campus --drive built-in --fault dust@30": "stands for all of its time: the gate takes the dust for an obstacle",
    "bench posegraph": DATA,
    "eval real3d --picture pair.png": DATA,
    "demo --robot go2 --world campus": "whatever it explored, judging 190 m of hills takes more than six minutes; LONG drives there",
    "navigate --robot go2 --world plot-17 --map runs/LATEST --lost --may-turn --start 12,30,90 -- 5,5 20,-8,180": EXPLORED,
    "navigate --robot go2 --world garage --map runs/LATEST --lost --may-turn -- 12,0@1": EXPLORED,
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
    assert sorted([*QUICK, *SHORTENED, *LONG, *NOT_RUN, *on_public_data]) == sorted(BLOCKS)


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
    return lengthened(command, limits)


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
