"""Thin skins around algorithms: topics in, one algorithm, topics out."""
