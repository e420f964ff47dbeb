"""`ambler bench frontier`: its options and its run stand in `studies.bench_frontier`."""

from ambler.studies.bench_frontier import add_parser

__all__ = ["add_parser"]
