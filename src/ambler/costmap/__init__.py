"""Costmaps as lists of layers: obstacles, inflation, glass, the static map; global and local."""
