"""`ambler bench raycast`: its options and its run stand in `studies.bench_raycast`."""

from ambler.studies.bench_raycast import add_parser

__all__ = ["add_parser"]
