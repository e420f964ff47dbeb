"""A site on another day: a share of its solids stands elsewhere or is gone. What belongs together (a trunk and its crown) goes together."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.site import Site
from ambler.sim.solids import Solid

FIXED = ("wall", "house", "porch", "slab", "column", "side", "roof", "end")
WAY = (0.5, 4.0)  # metres that things are moved by
KEEP = 1.2  # metres that what is moved keeps from the way
TRIES = 20


def change_site(site: Site, share: float, rng: np.random.Generator) -> tuple[Site, int]:
    """Return the site with `share` of its solids moved or, half of them, removed, and how many there are of these. What the site is built of stays."""
    solids = site.world.solids
    things: dict[str, list[int]] = defaultdict(list)
    for k, solid in enumerate(solids):
        kind, _, number = solid.name.partition("-")
        if kind not in FIXED:
            things[number or f"alone {k}"].append(k)
    wanted, changed = round(share * len(solids)), dict[int, Solid | None]()
    for name in rng.permutation(sorted(things)).tolist():
        if len(changed) >= wanted:
            break
        own = [solids[k] for k in things[name]]
        there = None if rng.random() < 0.5 else _moved(own, site.way, rng)
        gone: list[Solid | None] = [None] * len(own)
        changed |= dict(zip(things[name], there or gone, strict=True))
    kept = (changed.get(k, solid) for k, solid in enumerate(solids))
    world = replace(site.world, solids=tuple(s for s in kept if s is not None))
    return replace(site, world=world), len(changed)


def _moved(own: list[Solid], way: NDArray[np.float64], rng: np.random.Generator) -> list[Solid] | None:
    """Return things that belong together moved and turned about the first of them; None where no place was free of the way."""
    first = own[0].world_from_solid
    radius = max(0.5 * math.hypot(s.size_x, s.size_y) for s in own)
    height = 0.5 * (own[0].z_min + own[0].z_max)
    level = way[np.abs(way[:, 2] - height) < 3.0][:, :2]
    for _ in range(TRIES):
        far, bearing = float(rng.uniform(*WAY)), float(rng.uniform(-math.pi, math.pi))
        x, y = first.x + far * math.cos(bearing), first.y + far * math.sin(bearing)
        if len(level) and float(np.hypot(level[:, 0] - x, level[:, 1] - y).min()) < radius + KEEP:
            continue
        there = SE2(x, y, first.yaw + float(rng.uniform(-math.pi, math.pi)))
        return [replace(s, world_from_solid=there @ first.inverse() @ s.world_from_solid) for s in own]
    return None
