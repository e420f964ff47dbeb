"""`ambler bench particles`: its options and its run stand in `studies.bench_particles`."""

from ambler.studies.bench_particles import add_parser

__all__ = ["add_parser"]
