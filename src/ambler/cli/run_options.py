"""The options that all verbs of a simulated robot share, under the same names, and what they mean. Everything is checked before it runs."""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.apps.scene import RunOptions
    from ambler.core.se2 import SE2
    from ambler.nodes.steps import NavigateStep, Step
    from ambler.studies.study_settings import StudySettings

POSE = "X,Y[,DEG]"
GOAL = "X,Y[,DEG][@LEVEL]"
PLAN, CLOUD = "map.yaml", "map.cloud.pcd"  # what the folder of a run that made a map holds of it
TOKEN_LENGTH = 8  # characters of a token that opens the robot to a network


def add_run_options(parser: argparse.ArgumentParser, *, world: str, robot: str, time_limit: float) -> None:
    """Add everything that a run of a simulated robot can be told."""
    place = parser.add_argument_group("robot and place")
    place.add_argument(
        "--world",
        default=world,
        help=f"a built-in world, a drawn one (office-17), a world or map YAML, or a PNG (default: {world})",
    )
    place.add_argument(
        "--robot",
        default=robot,
        help=f"diff, spot, amr_omni, mecanum, go2, g1, one of them +ultrasonic, mecanum+tilted, or a URDF file (default: {robot})",
    )
    place.add_argument("--seed", type=int, default=0, help="seed of every random number (default: 0)")
    place.add_argument(
        "--start",
        metavar=POSE,
        help="where the robot starts, in metres and degrees from the world's own start (default: there)",
    )
    place.add_argument("--perfect", action="store_true", help="sensors without noise, odometry without drift")
    place.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    place.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND[@TARGET][:T0[:T1]]",
        help="let something go wrong from T0 to T1 s: " + ", ".join(FAULTS),
    )
    how = parser.add_argument_group("how it runs")
    how.add_argument("--realtime", action="store_true", help="run in the live executor, in real time")
    how.add_argument(
        "--apart",
        action="store_true",
        help="simulate in a process of its own; the robot runs live behind a serial line and a socket",
    )
    how.add_argument(
        "--time-limit", type=float, default=time_limit, help=f"seconds of the run (default: {time_limit:g})"
    )
    how.add_argument("--exit", action="store_true", help="end after the run even on a terminal")
    how.add_argument("--no-view", action="store_true", help="no live view")
    how.add_argument("--port", type=int, default=8765, help="port of the live view (default: 8765)")
    how.add_argument("--host", default="127.0.0.1", help="address of the live view (default: this machine only)")
    how.add_argument(
        "--token",
        help=f"what a viewer must present (at least {TOKEN_LENGTH} characters, required unless the view is local)",
    )
    add_settings(how)
    how.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    how.add_argument("--json", type=Path, help="write the result as JSON")


def add_settings(parser: argparse._ActionsContainer) -> None:
    """Add --profile and --set."""
    parser.add_argument("--profile", type=Path, help="YAML file with what differs from the robot's defaults")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override one setting")


def add_known_map_options(parser: argparse.ArgumentParser) -> None:
    """Add what concerns a known map."""
    known = parser.add_argument_group("the known map")
    known.add_argument(
        "--map",
        type=Path,
        help="saved map of that world: its YAML, or the folder of the run that made it (default: drawn from the world)",
    )
    known.add_argument("--localizer", choices=("tracker", "particles", "reflectors"), help="(default: tracker)")
    known.add_argument(
        "--source",
        choices=("scan", "cloud", "both", "points"),
        help="what it looks at (default: scan; with a scanner of many rings: points)",
    )
    known.add_argument("--lost", action="store_true", help="do not tell the robot where it starts")
    known.add_argument(
        "--may-turn",
        action="store_true",
        help="it may turn in place to find out, and go up to 1 m ahead or back to where it can",
    )


def add_unknown_options(parser: argparse.ArgumentParser) -> None:
    """Add what concerns drives without a map, and the choice of the planner."""
    unknown = parser.add_argument_group("the planner, and places without a map")
    unknown.add_argument(
        "--unknown",
        action="store_true",
        help="there is no map: the robot makes one as it drives and plans through what it has not seen",
    )
    unknown.add_argument("--planner", choices=("grid", "visibility_graph"), help="the global planner (default: grid)")


def add_dock_options(parser: argparse.ArgumentParser) -> None:
    """Add what concerns docks."""
    docks = parser.add_argument_group("the docks")
    docks.add_argument("--docks", type=Path, metavar="FILE", help="dock database (default: drawn from the world)")
    docks.add_argument("--camera", type=Path, metavar="FILE", help="calibration of the camera, a camera_info YAML")


FAULTS = (
    "wheel_slip",
    "scanner_dropout",
    "scanner_stuck",
    "delayed_stamps",
    "people",
    "door",
    "glass",
    "dust",
    "smoke",
    "rain",
    "light",
    "shadow",
    "blur",
    "occlusion",
    "marker_missing",
    "no_power",
)


def options_of(args: argparse.Namespace, steps: tuple[Step, ...], starts_docked: str | None = None) -> RunOptions:
    """Read and check the command line; raises BadInputError with one sentence."""
    from ambler.apps.scene import RunOptions

    _check_numbers(args)
    profile, faults = profile_of(args)
    named = vars(args)
    return RunOptions(
        steps=steps,
        world=args.world,
        robot=args.robot,
        seed=args.seed,
        start=None if args.start is None else parse_pose(args.start, "--start"),
        starts_docked=starts_docked,
        map_file=_map_file(named.get("map"), CLOUD if named.get("drive") else PLAN),
        docks_file=named.get("docks"),
        camera_file=named.get("camera"),
        is_lost=named.get("lost", False),
        may_turn=named.get("may_turn", False),
        is_unknown=named.get("unknown", False),
        is_realtime=args.realtime,
        is_apart=args.apart,
        is_perfect=args.perfect,
        physics="kinematic" if args.kinematic else "contact",
        port=None if args.no_view else args.port,
        host=args.host,
        token=args.token,
        time_limit=args.time_limit,
        profile=profile,
        faults=(*faults, *args.fault),
    )


def _map_file(path: Path | None, name: str) -> Path | None:
    """The map that is named, or that of a run whose folder is."""
    return path / name if path is not None and path.is_dir() else path


def profile_of(args: argparse.Namespace) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return what --profile, --set and the choices among strategies and localizers say, and the faults that these name."""
    from ambler.settings.profiles import load_profile, merge, parse_assignment

    profile = load_profile(args.profile) if args.profile else {}
    for text in args.set:
        profile = merge(profile, parse_assignment(text))
    faults = take_faults(profile)
    named = vars(args)
    if named.get("strategy"):
        profile = merge(profile, {"strategy": args.strategy})
    if named.get("planner"):
        profile = merge(profile, {"global_planner": args.planner})
    if named.get("localizer"):
        profile = merge(profile, {"localizer": args.localizer})
    if named.get("source"):
        profile = merge(profile, {"localization": {"source": args.source}})
    if named.get("stations") is not None:
        profile = merge(profile, {"explore": {"stations": {"spacing": args.stations}}})
    fence: dict[str, Any] = {}
    if named.get("radius") is not None:
        fence["radius"] = args.radius
    if named.get("boundary"):
        fence["boundary"] = [
            parse_pose(corner, "--boundary").as_array()[:2].tolist() for corner in args.boundary.split(";")
        ]
    if fence:
        profile = merge(profile, {"survey": {"fence": fence}})
    return profile, faults


def take_faults(profile: dict[str, Any]) -> tuple[str, ...]:
    """Take the faults out of a profile; raises BadInputError for what no run would take."""
    from ambler.core.errors import BadInputError

    faults = profile.pop("faults", [])
    if not isinstance(faults, list) or not all(isinstance(fault, str) for fault in faults):
        raise BadInputError(f"configuration faults: must be a list such as [wheel_slip:10:20], not {faults!r}")
    if faults:
        from ambler.sim.faults import Fault

        for fault in faults:
            Fault.parse(fault)
    return tuple(faults)


def study_settings(args: argparse.Namespace, *own: str, takes_faults: bool = True) -> StudySettings:
    """Return what `profile_of` says, for the robots of a study; raises BadInputError for the study's `own` settings (dotted names), and
    for faults where it takes none."""
    from ambler.core.errors import BadInputError
    from ambler.studies.study_settings import StudySettings

    settings, verb = StudySettings(*profile_of(args)), vars(args)[f"{args.verb}_verb"]
    settings.refuse(own, f"`ambler {args.verb} {verb}` sets this itself")
    if settings.faults and not takes_faults:
        raise BadInputError(f"configuration faults: `ambler {args.verb} {verb}` takes no faults")
    return settings


def parse_pose(text: str, what: str) -> SE2:
    """Read `x,y` or `x,y,degrees`, metres; raises BadInputError that names `what`."""
    from ambler.core.errors import BadInputError
    from ambler.core.se2 import SE2

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(math.isfinite(n) for n in numbers):
        raise BadInputError(f"{what} {text.strip()!r}: must be x,y or x,y,degrees")
    if max(abs(n) for n in numbers) > 1e5:
        raise BadInputError(f"{what} {text.strip()!r}: lies more than 100 km away")
    return SE2(numbers[0], numbers[1], math.radians(numbers[2]) if len(numbers) == 3 else 0.0)


def parse_goal(text: str, what: str) -> NavigateStep:
    """Read a pose as `parse_pose` does, and `@LEVEL` after it: on which level of a map of ground it lies. Raises BadInputError that names `what`."""
    from ambler.core.errors import BadInputError
    from ambler.nodes.steps import NavigateStep

    pose, at, level = text.partition("@")
    if at and not level.strip().isdecimal():
        raise BadInputError(f"{what} {text.strip()!r}: the level after @ must be a whole number, counted from 0")
    return NavigateStep(parse_pose(pose, what), level=int(level) if at else None)


def check_outputs(json_file: Path | None, out: Path | None) -> None:
    """Make the folders of the result and of the runs; raises BadInputError when they cannot be written, before anything runs."""
    from ambler.cli.results_output import check_targets
    from ambler.core.errors import BadInputError

    check_targets(json_file, out)
    wanted = {"--json": None if json_file is None else json_file.parent, "--out": out}
    for name, folder in wanted.items():
        try:
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
                with tempfile.TemporaryFile(dir=folder):
                    pass
        except OSError as error:
            raise BadInputError(f"{name}: {folder} cannot be written: {error.strerror}") from error


def _check_numbers(args: argparse.Namespace) -> None:
    from ambler.core.errors import BadInputError

    if args.seed < 0:
        raise BadInputError(f"--seed {args.seed}: must not be negative")
    if not (math.isfinite(args.time_limit) and args.time_limit > 0.0):
        raise BadInputError(f"--time-limit {args.time_limit:g}: must be a positive number of seconds")
    if not args.no_view and not 0 <= args.port <= 65535:
        raise BadInputError(f"--port {args.port}: must lie between 0 and 65535")
    if args.host not in ("127.0.0.1", "localhost", "::1") and not args.no_view:
        if not args.token:
            raise BadInputError(f"a live view on {args.host} needs --token: everybody there could drive the robot")
        if len(args.token) < TOKEN_LENGTH:
            raise BadInputError(f"--token: {len(args.token)} characters can be guessed, take {TOKEN_LENGTH} or more")


def is_attended(args: argparse.Namespace) -> bool:
    """Say whether somebody sits at a terminal and wants the robot to live on after its program."""
    return sys.stdout.isatty() and not args.exit
