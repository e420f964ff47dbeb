"""What verbs do with their results: print fields in two columns, write them as JSON when `--json` asks for it, fill a folder as a whole."""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
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


def check_targets(json_file: Path | None, out: Path | None) -> None:
    """Raise BadInputError where results would go to what is there and of another kind, before anything runs."""
    from ambler.core.errors import BadInputError

    if out is not None and out.exists() and not out.is_dir():
        raise BadInputError(f"{out}: is a file, but --out needs a folder")
    if json_file is not None and json_file.is_dir():
        raise BadInputError(f"--json {json_file}: is a folder")


@contextmanager
def partial_folder(out: Path) -> Iterator[Path]:
    """Give a folder beside the target and move what was written there, so that no partial output is ever seen; raises BadInputError."""
    from ambler.core.errors import BadInputError

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{out.name}.partial-", dir=out.parent))
    except OSError as failure:
        raise BadInputError(f"{out}: cannot be written: {failure.strerror or failure}") from failure
    try:
        yield partial
        out.mkdir(exist_ok=True)
        for file in sorted(partial.iterdir()):
            os.replace(file, out / file.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
