"""Frontiers: where they are, what each would show, which one is next, and when nothing is left."""
