"""Ambler: the whole stack of a LiDAR mobile robot in one package."""

__version__ = "0.1.0"
