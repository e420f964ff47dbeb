"""The dock database: a YAML file of docks by name, read with clear errors and written atomically.

```yaml
docks:
  charger_1:
    type: markers            # or v_shape, reflectors
    pose: [4.2, 1.0, 90.0]   # of the docked robot in the map: m, m, degrees
    offset: [0.0, 0.002, 0.0]
    approach_distance: 1.0
    contacts: charge         # or switch, none
    outline: [[0.62, -0.3], [0.9, -0.3], [0.9, 0.3], [0.62, 0.3]]
    markers:
      - {dictionary: 4X4_50, id: 3, size: 0.15, pose: [0.95, 0.0, 0.32, 0.0]}
```
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.dock import Dock
from ambler.docking.dock_table import dock_of_table, table_of_dock
from ambler.wire.atomic_file import write_whole
from ambler.wire.yaml_text import read_yaml

LEARNED = 20  # dockings after which a pose follows new ones no slower
JUMP = (0.3, math.radians(10.0))  # metres and radians by which one docking may contradict the file


class DockDatabase:
    """Docks by name. Changes are written at once."""

    def __init__(self, path: Path, docks: dict[str, Dock]) -> None:
        self._path = path
        self._docks = dict(docks)

    @classmethod
    def load(cls, path: Path) -> DockDatabase:
        """Read a file; raises BadInputError that names file, dock and field."""
        try:
            content = read_yaml(path)
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise BadInputError(f"{path}: cannot be read as YAML: {str(error).splitlines()[0]}") from error
        if not isinstance(content, dict) or set(content) != {"docks"} or not isinstance(content["docks"], dict):
            raise BadInputError(f"{path}: must hold one table `docks` of docks by name")
        docks: dict[str, Dock] = {}
        for name, table in content["docks"].items():
            if not isinstance(name, str) or not name:
                raise BadInputError(f"{path}: the name of a dock must be a word, not {name!r}")
            docks[name] = dock_of_table(f"{path}: dock {name}", name, table)
        _check_markers(path, docks)
        return cls(path, docks)

    @property
    def names(self) -> tuple[str, ...]:
        """The known docks, sorted."""
        return tuple(sorted(self._docks))

    def dock(self, name: str) -> Dock:
        """Return a dock; raises BadInputError with the known names."""
        found = self._docks.get(name)
        if found is None:
            raise BadInputError(f"no dock {name!r} in {self._path}; there are {', '.join(self.names) or 'none'}")
        return found

    def save(self) -> None:
        """Write the file: complete or not at all."""
        self._write(self._docks)

    def teach(self, dock: Dock, map_from_base: SE2) -> Dock:
        """Save a dock that the robot stands docked in: its pose is the robot's. A dock of that name is replaced."""
        _require_finite(map_from_base)
        return self._keep(replace(dock, map_from_dock=map_from_base, dockings=0))

    def refine(self, name: str, map_from_base: SE2) -> Dock:
        """Move a dock's pose towards where the robot stands docked: a mean of the dockings so far, of the last ones later.

        Raises BadInputError when the two are so far apart that one of them must be wrong; nothing is changed then.
        """
        _require_finite(map_from_base)
        dock = self.dock(name)
        away = dock.map_from_dock.distance_to(map_from_base)
        turn = wrap_angle(map_from_base.yaw - dock.map_from_dock.yaw)
        if away > JUMP[0] or abs(turn) > JUMP[1]:
            raise BadInputError(
                f"dock {name}: docked {away:.2f} m and {math.degrees(turn):.1f}° from its pose in {self._path}; teach it anew"
            )
        share = 1.0 / (min(dock.dockings, LEARNED) + 1)
        old = dock.map_from_dock
        pose = SE2(
            old.x + share * (map_from_base.x - old.x),
            old.y + share * (map_from_base.y - old.y),
            wrap_angle(old.yaw + share * turn),
        )
        return self._keep(replace(dock, map_from_dock=pose, dockings=dock.dockings + 1))

    def _keep(self, dock: Dock) -> Dock:
        """Put a dock in the place of that of its name; the file first, because what cannot be written must not be known either."""
        docks = {**self._docks, dock.name: dock}
        _check_markers(self._path, docks)
        self._write(docks)
        self._docks = docks
        return dock

    def _write(self, docks: dict[str, Dock]) -> None:
        content: dict[str, Any] = {"docks": {name: table_of_dock(docks[name]) for name in sorted(docks)}}
        write_whole(self._path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True))


def _require_finite(pose: SE2) -> None:
    if not np.isfinite(pose.as_array()).all():
        raise BadInputError("the pose of a docked robot must be finite")


def _check_markers(path: Path, docks: dict[str, Dock]) -> None:
    """A marker may belong to one dock only, and its printed size must be one."""
    owners: dict[tuple[str, int], str] = {}
    for name in sorted(docks):
        for marker in docks[name].markers:
            key = (marker.spec.dictionary, marker.spec.number)
            owner = owners.setdefault(key, name)
            if owner != name:
                raise BadInputError(f"{path}: marker {key[1]} of {key[0]} belongs to the docks {owner} and {name}")
