"""Errors of a trajectory against given relations (the SLAM benchmark of Burgard, Kuemmerle et al., "slamevaluation").

A relation `t1 t2 x y z roll pitch yaw` is the pose at t2 in the frame of t1. Its error is (estimated relation)^-1 * (given relation):
translational norm and absolute rotation; the result is mean and standard deviation over all relations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2


@dataclass(frozen=True, slots=True)
class Relation:
    """One given relation: stamps in microseconds."""

    from_us: int
    to_us: int
    from_from_to: SE2


@dataclass(frozen=True, slots=True, eq=False)
class RelationErrors:
    """Errors of the relations whose stamps were both found; float64 (K,) metres and radians, `to_us` int64 (K,) their second stamps."""

    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]
    to_us: NDArray[np.int64]
    given: int

    def fields(self) -> dict[str, float | int]:
        """Return the machine-readable fields."""
        return {
            "relations_used": len(self.translation),
            "translation_mean_m": float(self.translation.mean()),
            "translation_std_m": float(self.translation.std()),
            "rotation_mean_deg": math.degrees(float(self.rotation.mean())),
            "rotation_std_deg": math.degrees(float(self.rotation.std())),
        }


def _microseconds(field: str) -> int:
    value = float(field)
    if not 0.0 <= value < 1e11:
        raise ValueError(f"stamp {field} is impossible")
    return round(value * 1e6)


def load_relations(path: Path) -> list[Relation]:
    """Read a relations file; raises BadInputError naming the line."""
    relations: list[Relation] = []
    try:
        text = path.read_text(encoding="ascii")
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise BadInputError(f"{path}: byte {error.start} is no text; this is no relations file") from error
    for number, line in enumerate(text.splitlines(), 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            if len(fields) != 8:
                raise ValueError(f"needs 8 fields, but has {len(fields)}")
            v = [float(f) for f in fields[2:]]
            if not all(math.isfinite(x) for x in v):
                raise ValueError("a value is not finite")
            relations.append(Relation(_microseconds(fields[0]), _microseconds(fields[1]), SE2(v[0], v[1], v[5])))
        except ValueError as error:
            raise BadInputError(f"{path}: line {number}: {error}") from error
    if not relations:
        raise BadInputError(f"{path}: holds no relation")
    return relations


def relation_errors(
    relations: Sequence[Relation], stamps: Sequence[float], poses: NDArray[np.float64]
) -> RelationErrors:
    """Compare poses float64 (N, 3) at stamps (N,) in seconds with the relations; raises BadInputError when no stamp fits."""
    at = {round(stamp * 1e6): SE2.from_array(pose) for stamp, pose in zip(stamps, poses, strict=True)}
    errors: list[tuple[float, float]] = []
    to_us: list[int] = []
    for relation in relations:
        first, second = at.get(relation.from_us), at.get(relation.to_us)
        if first is None or second is None:
            continue
        error = (first.inverse() @ second).inverse() @ relation.from_from_to
        errors.append((math.hypot(error.x, error.y), abs(error.yaw)))
        to_us.append(relation.to_us)
    if not errors:
        raise BadInputError(f"none of the {len(relations)} relations has its stamps in the trajectory")
    table = np.array(errors)
    return RelationErrors(table[:, 0], table[:, 1], np.array(to_us, np.int64), len(relations))
