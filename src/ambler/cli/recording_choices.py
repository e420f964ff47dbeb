"""Options of the verbs that read a real robot's recording (`ambler slam2d`, `ambler localize`)."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ambler.core.se2 import SE2
    from ambler.recordings.scan_recording import Choices


def add_choices(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose topics, mount and order of the beams."""
    parser.add_argument("--scan-topic", metavar="NAME", help="bags: topic of the scans, where there are several")
    parser.add_argument(
        "--odom-topic", metavar="NAME", help="bags: topic of the odometry, where there are several; `none`: without"
    )
    parser.add_argument(
        "--mount",
        metavar="X,Y,YAW",
        help="the scanner in the base frame, m and deg, where the recording lacks it",
    )
    parser.add_argument(
        "--sweep",
        choices=("auto", "forward", "backward", "none"),
        default="auto",
        help="bags: order of a scan's beams in time; auto asks the recording (default)",
    )
    parser.add_argument(
        "--lag",
        metavar="SECONDS",
        help="by how much scans are stamped later than odometry; auto asks the recording (default)",
    )


def choices_of(args: argparse.Namespace) -> Choices:
    """Return what the options of `add_choices` say; raises BadInputError."""
    from ambler.recordings.scan_recording import Choices
    from ambler.recordings.sweep import Sweep

    mount = None if args.mount is None else parse_pose("--mount", args.mount)
    return Choices(args.scan_topic, args.odom_topic, mount, Sweep(args.sweep), _lag_of(args.lag))


def _lag_of(text: str | None) -> float | None:
    import math

    from ambler.core.errors import BadInputError

    if text in (None, "auto"):
        return None
    try:
        lag = float(text)
    except ValueError:
        lag = math.nan
    if not math.isfinite(lag):
        raise BadInputError(f"--lag {text}: is no number of seconds, nor `auto`")
    return lag


def parse_pose(option: str, text: str) -> SE2:
    """Return the pose of `X,Y,YAW` in metres and degrees; raises BadInputError that names the option."""
    import math

    from ambler.core.errors import BadInputError
    from ambler.core.se2 import SE2

    try:
        x, y, yaw_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInputError(f"{option} {text}: is not X,Y,YAW (metres and degrees)") from None
    if not math.isfinite(x + y + yaw_deg):
        raise BadInputError(f"{option} {text}: a value is not finite")
    return SE2(x, y, math.radians(yaw_deg))
