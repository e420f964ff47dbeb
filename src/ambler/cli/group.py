"""Verb groups: `ambler eval X` and `ambler bench X` collect the files `eval_*.py` and `bench_*.py` beside this one."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any


def add_group(subparsers: Any, verb: str, text: str) -> None:
    """Add a verb whose sub-verbs are the modules `<verb>_<name>.py`."""
    parser: argparse.ArgumentParser = subparsers.add_parser(verb, help=text, description=text)
    members = parser.add_subparsers(dest=f"{verb}_verb", metavar="WHAT", required=True)
    for path in sorted(Path(__file__).parent.glob(f"{verb}_*.py")):
        importlib.import_module(f"ambler.cli.{path.stem}").add_parser(members)
