"""`ambler animate RUN`: the recording of a run as an animated picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    text = "the recording of a run as an animated picture (GIF): the growing map, the robot, its way and its plan"
    parser: argparse.ArgumentParser = subparsers.add_parser("animate", help=text, description=text)
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="the folder of a run, such as runs/LATEST")
    parser.add_argument("--out", type=Path, help="the file (default: RUN/animation.gif)")
    parser.add_argument("--frames", type=int, default=80, help="pictures (default: 80)")
    parser.add_argument("--width", type=int, default=640, help="pixels (default: 640)")
    parser.add_argument("--seconds", type=float, default=10.0, help="for which it plays (default: 10)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Draw it."""
    from ambler.core.errors import BadInputError
    from ambler.evaluation.animation import animate

    if args.frames < 1 or args.width < 16 or not args.seconds > 0.0:
        raise BadInputError("--frames must be at least 1, --width at least 16, --seconds positive")
    recording = args.run_folder / "recording"
    path = args.out if args.out is not None else args.run_folder / "animation.gif"
    if path.is_dir():
        raise BadInputError(f"{path}: is a folder, but --out is the picture's file")
    path.parent.mkdir(parents=True, exist_ok=True)
    print(animate(recording if recording.exists() else args.run_folder, path, args.frames, args.width, args.seconds))
    return 0
