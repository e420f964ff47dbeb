"""`ambler eval results`: rewrite docs/results.md and the README's headlines from the files in docs/results."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "rewrite the page of results and the README's headlines"
    parser: argparse.ArgumentParser = subparsers.add_parser("results", help=text, description=text)
    parser.add_argument("--folder", type=Path, default=Path("docs/results"), help="where the result files are")
    parser.add_argument("--page", type=Path, default=Path("docs/results.md"), help="the page to write")
    parser.add_argument("--readme", type=Path, default=Path("README.md"), help="the file to update")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Update both and print the table."""
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results_table import results_table, update_page, update_readme

    if not args.readme.exists():
        raise BadInputError(f"{args.readme} does not exist")
    update_readme(args.readme, args.folder)
    update_page(args.page, args.folder)
    print(results_table(args.folder))
    return 0
