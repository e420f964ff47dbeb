"""`ambler bench ground`: its options and its run stand in `studies.bench_ground`."""

from ambler.studies.bench_ground import add_parser

__all__ = ["add_parser"]
