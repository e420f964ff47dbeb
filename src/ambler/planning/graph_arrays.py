"""The arrays of a visibility graph: nodes, the slots of their edges, and what an update remembers of each node."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import visibility as kernels

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


@dataclass(slots=True, eq=False)
class GraphArrays:
    """The nodes and the slots of their edges; `kernels.visibility` says what they hold. Lengths grow by doubling."""

    nodes: F64
    is_alive: NDArray[np.bool_]
    neighbor: NDArray[np.int32]
    weight: NDArray[np.float32]
    state: U8
    degree: NDArray[np.int32]
    ident: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    kind: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))
    missed: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))
    seen: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    place: F64 = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def graph(self) -> kernels.Graph:
        """What the kernels take."""
        return kernels.Graph(self.nodes, self.is_alive, self.neighbor, self.weight, self.state, self.degree)


def empty_arrays(nodes: int, slots: int) -> GraphArrays:
    """Return room for so many nodes with so many edges each."""
    return GraphArrays(
        *(np.zeros((nodes, 8)), np.zeros(nodes, np.bool_), np.zeros((nodes, slots), np.int32)),
        *(np.zeros((nodes, slots, 2), np.float32), np.zeros((nodes, slots, 4), np.uint8), np.zeros(nodes, np.int32)),
        np.zeros(nodes, np.int64),
        *(np.zeros(nodes, np.uint8), np.zeros(nodes, np.uint8)),
        np.zeros(nodes, np.int64),
        np.zeros((nodes, 2)),
    )


def copied_arrays(a: GraphArrays, nodes: int, slots: int) -> GraphArrays:
    """Return arrays of a larger size that hold what others held."""
    out, n, k = empty_arrays(nodes, slots), len(a.nodes), a.neighbor.shape[1]
    for name in ("nodes", "is_alive", "degree", "ident", "kind", "missed", "seen", "place"):
        getattr(out, name)[:n] = getattr(a, name)
    for name in ("neighbor", "weight", "state"):
        getattr(out, name)[:n, :k] = getattr(a, name)
    return out
