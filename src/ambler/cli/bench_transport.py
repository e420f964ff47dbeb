"""`ambler bench transport`: its options and its run stand in `studies.bench_transport`."""

from ambler.studies.bench_transport import add_parser

__all__ = ["add_parser"]
