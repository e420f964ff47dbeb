"""The current target among changing frontiers: which one it is now, and whether another is worth a switch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.messages import Frontier, FrontierState
from ambler.core.se2 import SE2
from ambler.exploration.strategies import Strategy
from ambler.exploration.survey import Survey


@dataclass(frozen=True, slots=True)
class ChoiceConfig:
    """A frontier is the target of a moment ago when `match_ratio` of its cells lie within `match_distance` (m) of it. The robot
    turns to another one only if that saves at least `hysteresis` of the way that is left, and `min_saving` (m)."""

    match_distance: float = 0.3
    match_ratio: float = 0.5
    hysteresis: float = 0.2
    min_saving: float = 0.5


def find_again(target: Frontier, survey: Survey, config: ChoiceConfig, *, is_open: bool = True) -> int | None:
    """Return the index of the open frontier (or of the unreachable one) that is the target, None when it is gone.

    Of several that match, it is the one that shares most with the target of what both hold together; a long neighbour may lie beside
    more of its cells than the target itself has.
    """
    own = target.cells.astype(np.float64)
    low, high = own.min(axis=0) - config.match_distance, own.max(axis=0) + config.match_distance
    tree: cKDTree | None = None
    best, best_share = None, 0.0
    wanted = FrontierState.OPEN if is_open else FrontierState.UNREACHABLE
    for i, frontier in enumerate(survey.frontiers):
        if frontier.state is not wanted:
            continue
        cells = frontier.cells.astype(np.float64)
        if not ((cells.max(axis=0) >= low) & (cells.min(axis=0) <= high)).all():
            continue
        tree = cKDTree(own) if tree is None else tree
        near = int(np.isfinite(tree.query(cells, distance_upper_bound=config.match_distance)[0]).sum())
        share = near / (len(cells) + tree.n - min(near, tree.n))
        if near >= config.match_ratio * min(len(cells), tree.n) and share > best_share:
            best, best_share = i, share
    return best


def choose(
    survey: Survey, strategy: Strategy, map_from_base: SE2, current: int | None, config: ChoiceConfig
) -> int | None:
    """Return the frontier to drive to, None when none is open; `current` is kept unless another is clearly better."""
    if not survey.open:
        return None
    costs: NDArray[np.float64] = strategy.costs(survey, map_from_base)
    best = int(np.argmin(costs))
    if current is None:
        return survey.open[best]
    saving = float(costs[survey.open.index(current)] - costs[best])
    left = survey.frontiers[current].path_distance
    is_better = saving >= max(config.hysteresis * left, config.min_saving)
    return survey.open[best] if is_better else current
