"""`ambler bench planner`: its options and its run stand in `studies.bench_planner`."""

from ambler.studies.bench_planner import add_parser

__all__ = ["add_parser"]
