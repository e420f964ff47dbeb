"""The planar part of the g2o text format: VERTEX_SE2 id x y yaw; EDGE_SE2 from to dx dy dyaw and the upper triangle of the
information matrix (I11 I12 I13 I22 I23 I33); FIX id. Blank lines and # comments are skipped; anything else is an error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole


@dataclass(frozen=True)
class G2oGraph:
    """poses float64 (N, 3) in the order of ascending ids; edges int64 (E,) as indices into poses; measurements float64 (E, 3);
    information float64 (E, 3, 3); ids int64 (N,) of the file; fixed: index of the FIX line's pose, or 0."""

    poses: NDArray[np.float64]
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    measurements: NDArray[np.float64]
    information: NDArray[np.float64]
    ids: NDArray[np.int64]
    fixed: int


def read_g2o(path: Path) -> G2oGraph:
    """Read a planar graph; raises BadInputError that names the file and the line."""
    vertices: dict[int, list[float]] = {}
    edges: list[tuple[int, int, int, list[float]]] = []
    fixed_id: int | None = None
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from error
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}:{number}"
        match words[0]:
            case "VERTEX_SE2":
                ids, values = _numbers(where, words, ids=1, values=3)
                if ids[0] in vertices:
                    raise BadInputError(f"{where}: pose {ids[0]} is given twice")
                vertices[ids[0]] = values
            case "EDGE_SE2":
                ids, values = _numbers(where, words, ids=2, values=9)
                edges.append((number, ids[0], ids[1], values))
            case "FIX":
                fixed_id = _numbers(where, words, ids=1, values=0)[0][0]
            case tag:
                raise BadInputError(f"{where}: {tag} is no planar vertex or edge")
    return _assemble(path, vertices, edges, fixed_id)


def write_g2o(path: Path, graph: G2oGraph) -> None:
    """Write a planar graph with all digits."""
    lines = [
        f"VERTEX_SE2 {i} " + " ".join(repr(float(v)) for v in p)
        for i, p in zip(graph.ids.tolist(), graph.poses, strict=True)
    ]
    lines.append(f"FIX {int(graph.ids[graph.fixed])}")
    upper = np.triu_indices(3)
    for k in range(len(graph.edge_from)):
        values = np.concatenate((graph.measurements[k], graph.information[k][upper]))
        a, b = int(graph.ids[graph.edge_from[k]]), int(graph.ids[graph.edge_to[k]])
        lines.append(f"EDGE_SE2 {a} {b} " + " ".join(repr(float(v)) for v in values))
    write_whole(path, "\n".join(lines) + "\n")


def _numbers(where: str, words: list[str], ids: int, values: int) -> tuple[list[int], list[float]]:
    if len(words) != 1 + ids + values:
        raise BadInputError(f"{where}: {words[0]} needs {ids + values} numbers, found {len(words) - 1}")
    try:
        keys, numbers = [int(w) for w in words[1 : 1 + ids]], [float(w) for w in words[1 + ids :]]
    except ValueError as error:
        raise BadInputError(f"{where}: {error}") from error
    if not all(math.isfinite(v) for v in numbers):
        raise BadInputError(f"{where}: a number is not finite")
    return keys, numbers


def _assemble(
    path: Path, vertices: dict[int, list[float]], edges: list[tuple[int, int, int, list[float]]], fixed_id: int | None
) -> G2oGraph:
    if not vertices:
        raise BadInputError(f"{path}: no VERTEX_SE2 line")
    ids = sorted(vertices)
    index = {key: k for k, key in enumerate(ids)}
    for number, a, b, _ in edges:
        for key in (a, b):
            if key not in index:
                raise BadInputError(f"{path}:{number}: pose {key} does not exist")
    if fixed_id is not None and fixed_id not in index:
        raise BadInputError(f"{path}: the fixed pose {fixed_id} does not exist")
    values = np.array([e[3] for e in edges], np.float64).reshape(len(edges), 9)
    upper = np.triu_indices(3)
    information = np.zeros((len(edges), 3, 3))
    information[:, upper[0], upper[1]] = values[:, 3:]
    information[:, upper[1], upper[0]] = values[:, 3:]
    return G2oGraph(
        poses=np.array([vertices[key] for key in ids], np.float64),
        edge_from=np.array([index[e[1]] for e in edges], np.int64),
        edge_to=np.array([index[e[2]] for e in edges], np.int64),
        measurements=np.ascontiguousarray(values[:, :3]),
        information=information,
        ids=np.array(ids, np.int64),
        fixed=0 if fixed_id is None else index[fixed_id],
    )
