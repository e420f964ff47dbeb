"""`ambler bench costmap`: its options and its run stand in `studies.bench_costmap`."""

from ambler.studies.bench_costmap import add_parser

__all__ = ["add_parser"]
