"""Planted faults: each must turn a fast test of its room red. `python -m tests.mutation` runs them all."""
