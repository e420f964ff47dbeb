"""Everything that a visibility graph holds of all floors as named arrays, and back, without loss: what `wire.graph_files` writes. Also what people are shown of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import VisibilityGraphView
from ambler.kernels import visibility as kernels
from ambler.planning.clearance_map import UnknownPrice
from ambler.planning.visibility_graph import VisibilityGraph, VisibilityGraphConfig

Arrays = dict[str, NDArray[Any]]
NODE_ARRAYS = ("nodes", "is_alive", "degree", "ident", "kind", "missed", "seen", "place")
EDGE_ARRAYS = ("neighbor", "weight", "state")


def to_arrays(graph: VisibilityGraph) -> Arrays:
    """Return all nodes, edges, votes and floors of a graph."""
    a = graph.arrays
    out: Arrays = {name: getattr(a, name).copy() for name in (*NODE_ARRAYS, *EDGE_ARRAYS)}
    for name in EDGE_ARRAYS:  # what lies beyond a node's last slot means nothing
        out[name][np.arange(a.neighbor.shape[1]) >= a.degree[:, None]] = 0
    last, before = graph.track
    out["counters"] = np.array([graph.next_ident, -1 if last is None else last], np.int64)
    out["before"] = np.array([] if before is None else before, np.float64)
    out["waiting"] = np.array(graph.waiting, np.int64)
    out["price"] = _prices(graph.price)
    for k, floor in enumerate(graph.floors):
        if floor.spec is None:
            continue
        s = floor.spec
        out[f"floor{k}.cells"] = floor.cells.copy()
        out[f"floor{k}.hidden"] = floor.hidden.copy()
        out[f"floor{k}.spec"] = np.array([s.resolution, s.origin_x, s.origin_y])
        if k in graph.pending:
            out[f"floor{k}.freed"] = graph.pending[k][0].copy()
            out[f"floor{k}.done"] = np.array([graph.pending[k][1]], np.int64)
    return out


def from_arrays(
    arrays: Mapping[str, NDArray[Any]],
    config: VisibilityGraphConfig | None = None,
    price: UnknownPrice | None = None,
) -> VisibilityGraph:
    """Return the graph that `to_arrays` told of; raises BadInputError when something is missing or does not fit. Where unknown ground has another price now, all edges are
    tested again by the next update."""
    graph = VisibilityGraph(config, price)
    try:
        n, slots = arrays["neighbor"].shape
        a = graph.restore(n, slots)
        for name in (*NODE_ARRAYS, *EDGE_ARRAYS):
            getattr(a, name)[:] = arrays[name]
        last = int(arrays["counters"][1])
        before = arrays["before"].tolist()
        graph.next_ident = int(arrays["counters"][0])
        track = (int(before[0]), *before[1:]) if before else None
        graph.track = (None if last < 0 else last, track)
        graph.waiting = arrays["waiting"].tolist()
        is_alike = np.array_equal(arrays["price"], _prices(price))
        for k in sorted(int(name[5:].split(".")[0]) for name in arrays if name.endswith(".cells")):
            if not is_alike:
                continue
            cells, spec = arrays[f"floor{k}.cells"], arrays[f"floor{k}.spec"].tolist()
            grid = GridSpec(spec[0], cells.shape[1], cells.shape[0], spec[1], spec[2])
            graph.floor(k).update(grid, cells, arrays[f"floor{k}.hidden"])
            if f"floor{k}.freed" in arrays:
                graph.pending[k] = (arrays[f"floor{k}.freed"].copy(), int(arrays[f"floor{k}.done"][0]))
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise BadInputError(f"a visibility graph lacks something, or does not fit together: {error}") from error
    return graph


def _prices(price: UnknownPrice | None) -> NDArray[np.float64]:
    price = price or UnknownPrice()
    return np.array([price.unknown, price.doubt, price.gap, price.wall])


def view_of(graph: VisibilityGraph, stamp_ns: int, frame: str, floor: int = 0) -> VisibilityGraphView:
    """Return what people are shown of a floor: nodes, the edges that are open now, each once, with their kinds, and the contours, all at the height of
    the maps."""
    a = graph.arrays
    is_here = a.is_alive & (a.nodes[:, kernels.FLOOR] == floor)
    slots = np.arange(a.neighbor.shape[1])
    rows, columns = np.nonzero((slots < a.degree[:, None]) & (a.state[:, :, kernels.OPEN] > 0) & is_here[:, None])
    others = a.neighbor[rows, columns]
    once = rows < others
    ends = np.stack((a.place[rows[once]], a.place[others[once]]), axis=1)
    kinds = a.state[rows[once], columns[once], kernels.KIND]
    return VisibilityGraphView(
        *(stamp_ns, frame, _flat(a.place[is_here]), a.kind[is_here].copy()),
        *(_flat(ends), kinds.copy(), tuple(_flat(curve) for curve in graph.contours(floor))),
    )


def _flat(places: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return places (..., 2) in metres as points (..., 3) of the plane."""
    return np.concatenate((places, np.zeros((*places.shape[:-1], 1))), axis=-1).astype(np.float32)
