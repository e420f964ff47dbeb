"""Everything that a visibility graph holds as named arrays, and back, without loss: what `wire.graph_files` writes. Also what people are shown of it."""

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
from ambler.planning.terrain_floors import Floor, TerrainConfig, TerrainFloors
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
    for k, floor in enumerate(graph.floors):
        if floor.spec is None:
            continue
        s = floor.spec
        out[f"floor{k}.cells"] = floor.cells.copy()
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
    """Return the graph that `to_arrays` told of; raises BadInputError when something is missing or does not fit."""
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
        for k in sorted(int(name[5:].split(".")[0]) for name in arrays if name.endswith(".cells")):
            cells, spec = arrays[f"floor{k}.cells"], arrays[f"floor{k}.spec"].tolist()
            graph.floor(k).update(GridSpec(spec[0], cells.shape[1], cells.shape[0], spec[1], spec[2]), cells)
            if f"floor{k}.freed" in arrays:
                graph.pending[k] = (arrays[f"floor{k}.freed"].copy(), int(arrays[f"floor{k}.done"][0]))
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise BadInputError(f"a visibility graph lacks something, or does not fit together: {error}") from error
    return graph


def floors_to_arrays(floors: TerrainFloors) -> Arrays:
    """Return a graph with the counts of the floors that feed it."""
    out = to_arrays(floors.graph)
    out["heights"] = np.array([floor.height for floor in floors.floors])
    for k, floor in enumerate(floors.floors):
        s = floor.spec
        out[f"terrain{k}.counts"], out[f"terrain{k}.seen"] = floor.counts.copy(), floor.is_seen.copy()
        out[f"terrain{k}.spec"] = np.array([s.resolution, s.origin_x, s.origin_y])
    return out


def floors_from_arrays(
    arrays: Mapping[str, NDArray[Any]],
    config: TerrainConfig | None = None,
    graph_config: VisibilityGraphConfig | None = None,
) -> TerrainFloors:
    """Return what `floors_to_arrays` told of; raises BadInputError."""
    own = {name: array for name, array in arrays.items() if not name.startswith("terrain") and name != "heights"}
    floors = TerrainFloors(from_arrays(own, graph_config), config)
    try:
        for k, height in enumerate(arrays["heights"].tolist()):
            floor = Floor(floors.config, height)
            counts, spec = arrays[f"terrain{k}.counts"], arrays[f"terrain{k}.spec"].tolist()
            floor.spec = GridSpec(spec[0], counts.shape[1], counts.shape[0], spec[1], spec[2])
            floor.counts, floor.is_seen = counts.copy(), arrays[f"terrain{k}.seen"].copy()
            floors.floors.append(floor)
    except (KeyError, ValueError, IndexError) as error:
        raise BadInputError(f"the floors of a visibility graph lack something: {error}") from error
    return floors


def view_of(graph: VisibilityGraph, stamp_ns: int, frame: str) -> VisibilityGraphView:
    """Return what people are shown: nodes, the edges that are open now, each once, with their kinds, and the contours."""
    a = graph.arrays
    alive = np.flatnonzero(a.is_alive)
    slots = np.arange(a.neighbor.shape[1])
    rows, columns = np.nonzero((slots < a.degree[:, None]) & (a.state[:, :, kernels.OPEN] > 0) & a.is_alive[:, None])
    others = a.neighbor[rows, columns]
    once = rows < others
    ends = np.stack((a.place[rows[once]], a.place[others[once]]), axis=1)
    kinds = a.state[rows[once], columns[once], kernels.KIND]
    return VisibilityGraphView(
        *(stamp_ns, frame, a.place[alive].astype(np.float32), a.kind[alive].copy()),
        *(ends.astype(np.float32), kinds.copy(), graph.contours()),
    )
