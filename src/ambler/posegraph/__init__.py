"""A sparse robust solver of planar pose graphs."""
