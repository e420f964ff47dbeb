"""Typed configuration: frozen dataclasses beside their algorithms, YAML profiles over their defaults, one resolved file per run."""
