"""Robots as data: footprints, drives, limits, where sensors sit and where they look, built in or read from URDF files. No noise."""
