"""Docks: what they are, where they are kept, how they are seen, and how what was seen becomes one pose."""
