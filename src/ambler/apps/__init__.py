"""Robots as short lists of nodes, and the programs that run them."""
