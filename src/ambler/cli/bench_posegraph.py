"""`ambler bench posegraph`: its options and its run stand in `studies.bench_posegraph`."""

from ambler.studies.bench_posegraph import add_parser

__all__ = ["add_parser"]
