"""Rectangles along the axes, of which plans are made."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Rect:
    """A rectangle in the frame of the plan, metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Its size along x."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Its size along y."""
        return self.y1 - self.y0

    @property
    def area(self) -> float:
        return self.width * self.depth

    @property
    def center(self) -> tuple[float, float]:
        return 0.5 * (self.x0 + self.x1), 0.5 * (self.y0 + self.y1)

    def inset(self, margin: float) -> Rect:
        """Return it without a margin all around (a negative one makes it larger)."""
        return Rect(self.x0 + margin, self.y0 + margin, self.x1 - margin, self.y1 - margin)

    def overlaps(self, other: Rect, gap: float = 0.0) -> bool:
        """Tell whether the two come nearer than `gap` metres along both axes."""
        return (
            self.x0 < other.x1 + gap
            and other.x0 < self.x1 + gap
            and self.y0 < other.y1 + gap
            and other.y0 < self.y1 + gap
        )

    def contains(self, other: Rect) -> bool:
        """Tell whether the other lies inside."""
        return self.x0 <= other.x0 and self.y0 <= other.y0 and self.x1 >= other.x1 and self.y1 >= other.y1

    def has(self, x: float, y: float) -> bool:
        """Tell whether a point lies inside."""
        return self.x0 <= x <= self.x1 and self.y0 <= y <= self.y1

    def cut_x(self, widths: Sequence[float]) -> list[Rect]:
        """Cut it into pieces side by side along x; the widths are scaled so that they fill it."""
        edges = self.x0 + np.concatenate([[0.0], np.cumsum(widths)]) * (self.width / sum(widths))
        return [Rect(float(a), self.y0, float(b), self.y1) for a, b in itertools.pairwise(edges)]

    def cut_y(self, depths: Sequence[float]) -> list[Rect]:
        """Cut it into pieces one above the other along y; the depths are scaled so that they fill it."""
        edges = self.y0 + np.concatenate([[0.0], np.cumsum(depths)]) * (self.depth / sum(depths))
        return [Rect(self.x0, float(a), self.x1, float(b)) for a, b in itertools.pairwise(edges)]


def around(center: tuple[float, float], width: float, depth: float) -> Rect:
    """Return the rectangle of a size about a centre."""
    x, y = center
    return Rect(x - 0.5 * width, y - 0.5 * depth, x + 0.5 * width, y + 0.5 * depth)


def drawn_widths(rng: np.random.Generator, length: float, least: float, most: float) -> list[float]:
    """Draw how a row of `length` metres is divided into parts of about `least` to `most` metres."""
    parts: list[float] = []
    while sum(parts) < length - 0.5 * least:
        parts.append(float(rng.uniform(least, most)))
    return parts
