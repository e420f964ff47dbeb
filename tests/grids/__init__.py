"""Tests of the probability grids: their numbers, scan insertion, growth and composition."""
