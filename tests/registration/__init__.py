"""Tests of the planar matchers; `room` is the world they look at."""
