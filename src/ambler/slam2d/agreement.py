"""Which closures to believe: those that move the map little, and those that move it far, or that little speaks for, and that several others, on a longer way, confirm.

One place that looks like another gives a closure that fits its scan well. Several such closures in a row that all move the map in the same
way are what a true closure brings and chance does not (pairwise consistency: Mangelson, Dominic, Eustice and Vasudevan, ICRA 2018). Those who
contradict them count as far as they agree among themselves. What is not believed waits for more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.slam2d.config import LoopConfig
from ambler.slam2d.loop_closure import Closure

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]


def sort_closures(
    closures: Sequence[Closure], poses: F64, ways: F64, config: LoopConfig
) -> tuple[list[Closure], list[Closure]]:
    """Split closures into those to believe and those that wait.

    `poses` float64 (V, 3) are those of all vertices now, `ways` float64 (N,) the way driven until each node, metres.
    """
    moved = [moves_map_by(closure, poses) for closure in closures]
    is_far = np.array([m > config.surprise or c.is_partial for c, m in zip(closures, moved, strict=True)], np.bool_)
    believed = [c for c, far in zip(closures, is_far, strict=True) if not far]
    far = [c for c, is_it in zip(closures, is_far, strict=True) if is_it]
    confirmed = _confirmed(far, np.array(moved)[is_far], poses, ways, config)
    believed += [c for c, is_it in zip(far, confirmed, strict=True) if is_it]
    waiting = [c for c, is_it in zip(far, confirmed, strict=True) if not is_it]
    return believed, waiting[-config.most_pending :]


def moves_map_by(closure: Closure, poses: F64) -> float:
    """Return how far a closure would move its node, metres."""
    edge = closure.edge
    wanted = SE2.from_array(poses[edge.edge_from]) @ edge.from_from_to
    return wanted.distance_to(SE2.from_array(poses[edge.edge_to]))


def _confirmed(far: list[Closure], moved: F64, poses: F64, ways: F64, config: LoopConfig) -> B:
    n = len(far)
    out = np.zeros(n, np.bool_)
    if n < config.confirmations:
        return out
    agrees = _agreements(far, poses, ways, config)
    nodes, groups = np.array([c.node for c in far]), _groups(agrees)
    at = ways[nodes]
    for group in groups:
        own = len(np.unique(nodes[group]))
        low, high = at[group].min(), at[group].max()
        if own < config.confirmations or high - low < np.clip(config.spread_ratio * moved[group].min(), *config.spread):
            continue
        is_against = (at >= low) & (at <= high) & (2 * agrees[:, group].sum(axis=1) < len(group))
        rival = max(len(np.unique(nodes[g[is_against[g]]])) for g in groups)
        out[group] = 2 * rival < own
    return out


def _groups(agrees: B) -> list[I64]:
    """Part closures into groups all of which agree with each other, grown greedily, from and by those with most friends left."""
    left, out = np.ones(len(agrees), np.bool_), []
    while left.any():
        friends = np.where(left, (agrees & left).sum(axis=1), -1)
        first = int(np.argmax(friends))
        group, fits = [first], agrees[first] & left
        for k in np.argsort(-friends, kind="stable"):
            if fits[k] and k != first:
                group.append(int(k))
                fits = fits & agrees[k]
        left[group] = False
        out.append(np.array(sorted(group), np.int64))
    return out


def _agreements(far: list[Closure], poses: F64, ways: F64, config: LoopConfig) -> B:
    """Return which pairs (n, n) of closures move the map in the same way: between their nodes lies, by them, what the graph says."""
    wanted = np.array([(SE2.from_array(poses[c.edge.edge_from]) @ c.edge.from_from_to).as_array() for c in far])
    held = poses[[c.edge.edge_to for c in far]]
    way = ways[[c.node for c in far]]
    between = np.abs(way[:, None] - way)
    off = _relative(wanted) - _relative(held)
    turn = np.abs((off[..., 2] + np.pi) % (2.0 * np.pi) - np.pi)
    near = np.hypot(off[..., 0], off[..., 1]) < config.agreement[0] + config.agreement_per_metre[0] * between
    return np.asarray(near & (turn < config.agreement[1] + config.agreement_per_metre[1] * between))


def _relative(poses: F64) -> F64:
    """Return each pose (n, n, 3) in the frame of each other."""
    d = poses[None, :, :2] - poses[:, None, :2]
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1]
    return np.stack((x, y, poses[None, :, 2] - poses[:, None, 2]), axis=-1)
