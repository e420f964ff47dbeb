"""`ambler bench exploration`: its options and its run stand in `studies.bench_exploration`."""

from ambler.studies.bench_exploration import add_parser

__all__ = ["add_parser"]
