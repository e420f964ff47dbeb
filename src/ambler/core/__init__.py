"""Shared vocabulary: poses, messages, grids, the robot, protocols, errors. Imports nothing of Ambler."""
