"""`ambler`: parses the verb, maps errors to one clear line and an exit code (0 done, 1 fell short, 2 bad input, 130 interrupted)."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shlex
import sys

from ambler import __version__

VERBS = (
    "demo",
    "navigate",
    "dock",
    "undock",
    "slam2d",
    "lio",
    "localize",
    "replay",
    "animate",
    "config",
    "robot",
    "world",
    "tune",
    "calibrate",
    "eval",
    "bench",
    "warmup",
)

# Argparse would take a goal such as -5,0 for an option; with a space before it, it is what it looks like.
_NEGATIVE_POSE = re.compile(r"-[\d.][^,]*,.*")

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with every verb."""
    parser = argparse.ArgumentParser(prog="ambler", description="The whole stack of a LiDAR mobile robot.")
    parser.add_argument("--version", action="version", version=f"ambler {__version__}")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for verb in VERBS:
        importlib.import_module(f"ambler.cli.{verb}").add_parser(subparsers)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run one verb and return its exit code. Without `arguments` the process is the verb's own, and so are its habits."""
    from ambler.apps.signals import Interrupted, terminate_like_interrupt, was_interrupted
    from ambler.core.errors import AmblerError, BadInputError
    from ambler.core.large_memory import keep_memory_small

    if arguments is None:
        keep_memory_small()
    terminate_like_interrupt()
    words = sys.argv[1:] if arguments is None else arguments
    try:
        args = build_parser().parse_args([f" {word}" if _NEGATIVE_POSE.fullmatch(word) else word for word in words])
        args.command_line = shlex.join(["ambler", *words])
        code = int(args.run(args))
        if was_interrupted():
            raise Interrupted
        return code
    except (Exception, KeyboardInterrupt) as error:
        if was_interrupted() or isinstance(error, KeyboardInterrupt):
            # An import that a signal cuts off may raise anything.
            broken = "" if isinstance(error, KeyboardInterrupt) else f" ({type(error).__name__}: {error})"
            print(f"ambler: interrupted{broken}", file=sys.stderr)
            return 130
        if isinstance(error, BrokenPipeError):  # who reads has heard enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 141
        if isinstance(error, BadInputError):
            print(f"ambler: {error}", file=sys.stderr)
            return 2
        if isinstance(error, AmblerError):
            print(f"ambler: {error.code}: {error}", file=sys.stderr)
            return 1
        raise


if __name__ == "__main__":
    sys.exit(main())
