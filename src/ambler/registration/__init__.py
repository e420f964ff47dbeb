"""Scan matchers that several rooms share, and the planar scan they take."""
