"""`ambler eval …`: how good something is."""

from typing import Any

from ambler.cli.group import add_group


def add_parser(subparsers: Any) -> None:
    """Add the verb group."""
    add_group(subparsers, "eval", "measure how good a result is")
