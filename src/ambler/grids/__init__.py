"""Probability grids: the numbers in a cell, and a grid that grows with its scans."""
