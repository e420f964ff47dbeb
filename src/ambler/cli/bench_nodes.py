"""`ambler bench nodes`: its options and its run stand in `studies.bench_nodes`."""

from ambler.studies.bench_nodes import add_parser

__all__ = ["add_parser"]
