"""What the verbs that measure do with their fields: print them in two columns, write them as JSON when `--json` asks for it."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from typing import Any


def print_fields(fields: Mapping[str, Any], width: int, floats: str = "", others: str = "") -> None:
    """Print a line per field: its name, filled up to `width`, and its value by one of two format specifications."""
    for name, value in fields.items():
        print(f"{name:{width}} {value:{floats if isinstance(value, float) else others}}")


def save_json(args: argparse.Namespace, begin: float, fields: Mapping[str, Any]) -> None:
    """Write the fields to `args.json`, if given, with the command line, the seed and the seconds since `begin` (perf_counter)."""
    from ambler.evaluation.results import write_results

    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
