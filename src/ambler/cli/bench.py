"""`ambler bench …`: how fast something is, beside its peers in the same run."""

from typing import Any

from ambler.cli.group import add_group


def add_parser(subparsers: Any) -> None:
    """Add the verb group."""
    add_group(subparsers, "bench", "measure how fast a part is, beside its peers")
