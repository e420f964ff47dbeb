"""Mounts, clocks, cameras, ranges, wheels: what finds them, apart from what uses them."""
