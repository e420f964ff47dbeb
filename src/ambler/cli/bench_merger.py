"""`ambler bench merger`: its options and its run stand in `studies.bench_merger`."""

from ambler.studies.bench_merger import add_parser

__all__ = ["add_parser"]
