"""Paths on grids that keep a footprint out of obstacles."""
