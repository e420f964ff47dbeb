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

COST, SEEN, WAY, MOMENT = 0, 1, 2, 3
LEAST_SAVING = 1e-9


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
def add_up(order: I64, legs: F64, weights: F64, urgency: float, sums: F64) -> None:
    """Write running sums of an order into `sums` (4, N + 1): what the tour has cost on arrival at each place (COST), the weight of the
    places before it (SEEN), the length of the way from the first place to it (WAY), and the sum over that way of each leg times the
    weight of the places before its end (MOMENT). COST at N is that of the whole tour.

    `legs` (N + 1, N + 1) from place to place, symmetric; number N is where the robot stands.
    """
    n = len(order)
    here, cost, seen, way, moment = n, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        leg = legs[here, order[i]]
        cost += leg * (1.0 + urgency * (1.0 - seen))
        if i > 0:
            way += leg
            moment += leg * seen
        sums[COST, i], sums[SEEN, i], sums[WAY, i], sums[MOMENT, i] = cost, seen, way, moment
        here = order[i]
        seen += weights[here]
    sums[COST, n], sums[SEEN, n] = cost, seen


@jit
def _stretch_cost(first: int, last: int, waiting: float, is_turned: bool, urgency: float, sums: F64) -> float:
    """Return what it costs to go from index `first` of an order to `last`, or (`is_turned`) back, while `waiting` waits on arrival at the
    stretch."""
    way, moment = sums[WAY, last] - sums[WAY, first], sums[MOMENT, last] - sums[MOMENT, first]
    if is_turned:
        return float(way * (1.0 + urgency * (waiting - sums[SEEN, last + 1])) + urgency * moment)
    return float(way * (1.0 + urgency * (waiting + sums[SEEN, first])) - urgency * moment)


@jit
def change_saving(order: I64, first: int, length: int, to: int, legs: F64, urgency: float, sums: F64) -> float:
    """Return how much cheaper `order` gets with `length` places from index `first` on turned round (`to` < 0), or taken out and put in
    before index `to` of the rest. Constant time: the stretches between the cuts come out of the running sums."""
    n = len(order)
    last = first + length - 1
    begin, end = first, last + 1  # what changes, and the first two places there: one stretch after the other
    a, b, c, d = first, last, 0, -1
    if to >= 0 and to < first:
        begin, c, d = to, to, first - 1
    elif to >= 0:
        end = to + length
        a, b, c, d = last + 1, end - 1, first, last
    waiting = 1.0 - sums[SEEN, begin]
    before, cost = n, 0.0
    if begin > 0:
        before, cost = order[begin - 1], sums[COST, begin - 1]
    is_turned = to < 0
    cost += legs[before, order[b if is_turned else a]] * (1.0 + urgency * waiting)
    cost += _stretch_cost(a, b, waiting, is_turned, urgency, sums)
    waiting -= sums[SEEN, b + 1] - sums[SEEN, a]
    tail = order[a if is_turned else b]
    if c <= d:
        cost += legs[tail, order[c]] * (1.0 + urgency * waiting)
        cost += _stretch_cost(c, d, waiting, False, urgency, sums)
        waiting -= sums[SEEN, d + 1] - sums[SEEN, c]
        tail = order[d]
    if end == n:
        return float(sums[COST, n] - cost)
    return float(sums[COST, end] - cost - legs[tail, order[end]] * (1.0 + urgency * waiting))


@jit
def change(order: I64, first: int, length: int, to: int, trial: I64) -> None:
    """Change an order in place, see `change_saving`. `trial` (N,) is scratch."""
    trial[:] = order
    if to < 0:
        order[first : first + length] = trial[first : first + length][::-1]
        return
    if to < first:
        order[to + length : first + length] = trial[to:first]
    else:
        order[first:to] = trial[first + length : to + length]
    order[to : to + length] = trial[first : first + length]


@jit
def _improve(order: I64, fixed: int, sweeps: int, legs: F64, weights: F64, urgency: float, trial: I64) -> float:
    """Improve an order in place by turning stretches round (2-opt) and moving up to three places (Or-opt), while the first `fixed`
    places stay. Return its cost."""
    n = len(order)
    sums = np.empty((4, n + 1))
    add_up(order, legs, weights, urgency, sums)
    for _ in range(sweeps):
        before = sums[COST, n]
        for kind in range(4):  # 0: turned round, otherwise so many places moved
            for first in range(fixed, n):
                for other in range(fixed, n):
                    length, to = (kind, other) if kind > 0 else (other - first + 1, -1)
                    if length < 1 or first + length > n or to + length > n or to == first:
                        continue
                    if change_saving(order, first, length, to, legs, urgency, sums) > LEAST_SAVING:
                        change(order, first, length, to, trial)
                        add_up(order, legs, weights, urgency, sums)
        if sums[COST, n] == before:
            break
    return float(sums[COST, n])


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
    with the place moved to the front. `between` is symmetric; `orders` is scratch, int64 (3, N).
    """
    n = len(from_robot)
    order, base, trial = orders[0], orders[1], orders[2]
    legs = np.zeros((n + 1, n + 1))
    legs[:n, :n], legs[n, :n] = between, from_robot
    for i in range(n):
        base[i] = i
    for i in range(n):
        best, least = i, np.inf
        for k in range(i, n):
            d = legs[n if i == 0 else base[i - 1], base[k]]
            if d < least:
                best, least = k, d
        base[i], base[best] = base[best], base[i]
    out[base[0]] = _improve(base, 0, 4 * sweeps, legs, weights, urgency, trial)
    for i in range(1, n):
        order[0] = base[i]
        order[1 : i + 1], order[i + 1 :] = base[:i], base[i + 1 :]
        out[base[i]] = _improve(order, 1, sweeps, legs, weights, urgency, trial)


def warm_up() -> None:
    """Compile every kernel with its real dtypes."""
    one, two, out = np.ones(2), np.ones((2, 2)), np.empty(2)
    tour_costs(one, two, 0.5 * one, 1.0, np.empty(4), np.empty((4, 2)), out)
    near_tour_costs(one, two, 0.5 * one, 1.0, 1, np.zeros((3, 2), np.int64), out)
