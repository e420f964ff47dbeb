"""`ambler bench control`: its options and its run stand in `studies.bench_control`."""

from ambler.studies.bench_control import add_parser

__all__ = ["add_parser"]
