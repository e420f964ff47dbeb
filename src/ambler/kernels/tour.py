"""Tours through weighted places: the cheapest order to visit them all, with each place in turn as the first.

A tour of legs d_1 … d_n costs `sum d_i (1 + urgency W_i)`, where W_i is the share of all weight that is still to be visited during
leg i: its length, plus `urgency` times the mean distance after which weight is visited. With urgency 0 this is the travelling
salesman's problem, for a large one the travelling repairman's.
"""

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@jit
def tour_costs(from_robot: F64, between: F64, weights: F64, urgency: float, waiting: F64, table: F64, out: F64) -> None:
    """Write for each place the cost of the best tour over all places that begins there, exactly (Held and Karp 1962).

    `from_robot`, `weights` (N,), weights of sum 1, `between` (N, N); scratch: `waiting` (2**N,) and `table` (2**N, N), in which
    table[S, j] is the least cost from j, having to visit the set S, which contains j.
    """
    n = len(from_robot)
    waiting[0] = 0.0
    for j in range(n):
        for subset in range(1 << j):
            waiting[(1 << j) + subset] = waiting[subset] + weights[j]
    for subset in range(1, 1 << n):
        for j in range(n):
            if not (subset >> j) & 1:
                continue
            rest = subset ^ (1 << j)
            if rest == 0:
                table[subset, j] = 0.0
                continue
            price = 1.0 + urgency * waiting[rest]
            best = np.inf
            for k in range(n):
                if (rest >> k) & 1:
                    best = min(best, between[j, k] * price + table[rest, k])
            table[subset, j] = best
    for j in range(n):
        out[j] = from_robot[j] * (1.0 + urgency) + table[(1 << n) - 1, j]


@jit
def order_cost(order: I64, from_robot: F64, between: F64, weights: F64, urgency: float) -> float:
    """Return the cost of visiting all places in an order."""
    waiting = 1.0
    total = from_robot[order[0]] * (1.0 + urgency)
    for i in range(1, len(order)):
        waiting -= weights[order[i - 1]]
        total += between[order[i - 1], order[i]] * (1.0 + urgency * waiting)
    return float(total)


@jit
def _turn(order: I64, first: int, length: int, out: I64) -> None:
    """Write `order` with `length` places from index `first` on turned round."""
    out[:] = order
    for i in range(length):
        out[first + i] = order[first + length - 1 - i]


@jit
def _move(order: I64, first: int, length: int, to: int, out: I64) -> None:
    """Write `order` with `length` places from index `first` on taken out and put in before index `to` of the rest."""
    k = 0
    rest = len(order) - length
    for i in range(rest + 1):
        if i == to:
            out[k : k + length] = order[first : first + length]
            k += length
        if i < rest:
            out[k] = order[i if i < first else i + length]
            k += 1


@jit
def _improve(
    order: I64, fixed: int, sweeps: int, from_robot: F64, between: F64, weights: F64, urgency: float, trial: I64
) -> float:
    """Improve an order in place by turning stretches round (2-opt) and moving up to three places (Or-opt), while the first `fixed`
    places stay. Return its cost."""
    n = len(order)
    best = order_cost(order, from_robot, between, weights, urgency)
    for _ in range(sweeps):
        before = best
        for i in range(fixed, n - 1):
            for length in range(2, n - i + 1):
                _turn(order, i, length, trial)
                cost = order_cost(trial, from_robot, between, weights, urgency)
                if cost < best - 1e-9:
                    best = cost
                    order[:] = trial
        for length in range(1, 4):
            for i in range(fixed, n - length + 1):
                for to in range(fixed, n - length + 1):
                    _move(order, i, length, to, trial)
                    cost = order_cost(trial, from_robot, between, weights, urgency)
                    if cost < best - 1e-9:
                        best = cost
                        order[:] = trial
        if best == before:
            break
    return float(best)


@jit
def near_tour_costs(
    from_robot: F64,
    between: F64,
    weights: F64,
    urgency: float,
    sweeps: int,
    orders: I64,
    out: F64,
) -> None:
    """Write for each place the cost of a good tour that begins there, by local search: for more places than `tour_costs` can take.

    One tour is improved from the order of always going to the nearest place; the tours of the other first places start from it,
    with the place moved to the front. `orders` is scratch, int64 (3, N).
    """
    n = len(from_robot)
    order, base, trial = orders[0], orders[1], orders[2]
    for i in range(n):
        base[i] = i
    for i in range(n):
        best, least = i, np.inf
        for k in range(i, n):
            d = from_robot[base[k]] if i == 0 else between[base[i - 1], base[k]]
            if d < least:
                best, least = k, d
        base[i], base[best] = base[best], base[i]
    cost = _improve(base, 0, 4 * sweeps, from_robot, between, weights, urgency, trial)
    out[base[0]] = cost
    for i in range(1, n):
        _move(base, i, 1, 0, order)
        out[base[i]] = _improve(order, 1, sweeps, from_robot, between, weights, urgency, trial)


def warm_up() -> None:
    """Compile every kernel with its real dtypes."""
    one, two, out = np.ones(2), np.ones((2, 2)), np.empty(2)
    tour_costs(one, two, 0.5 * one, 1.0, np.empty(4), np.empty((4, 2)), out)
    near_tour_costs(one, two, 0.5 * one, 1.0, 1, np.zeros((3, 2), np.int64), out)
