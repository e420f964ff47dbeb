"""`ambler eval results`: rewrite docs/results.md, the README's headlines and the tables of docs/docking.md from the files in docs/results."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "rewrite the page of results, the README's headlines and the tables of the page on docking"
    parser: argparse.ArgumentParser = subparsers.add_parser("results", help=text, description=text)
    parser.add_argument("--folder", type=Path, default=Path("docs/results"), help="where the result files are")
    parser.add_argument("--page", type=Path, default=Path("docs/results.md"), help="the page to write")
    parser.add_argument("--readme", type=Path, default=Path("README.md"), help="the file to update")
    parser.add_argument("--docking", type=Path, default=Path("docs/docking.md"), help="the page on docking to update")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Update all and print the table."""
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results_table import results_table, update_docking, update_page, update_readme

    if not args.readme.exists():
        raise BadInputError(f"{args.readme} does not exist")
    update_readme(args.readme, args.folder)
    update_page(args.page, args.folder)
    if args.docking.exists():
        update_docking(args.docking, args.folder)
    print(results_table(args.folder))
    return 0
