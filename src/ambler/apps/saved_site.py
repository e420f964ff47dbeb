"""What an exploration of a site leaves for later runs: `<stem>.yaml` of its first level, `<stem>.levels.npz` with all levels and passages, and
`<stem>.cloud.pcd`, the cloud to be localized in."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.lio.cloud_map import CloudMap
from ambler.lio.config import CloudMapConfig
from ambler.perception.known_ground import KnownGround, KnownLevel
from ambler.wire.cloud_files import CLOUD_SUFFIX
from ambler.wire.ground_files import SUFFIX as LEVELS_SUFFIX
from ambler.wire.ground_files import load_levels, load_passages


@dataclass(frozen=True, slots=True, eq=False)
class SavedSite:
    """Levels of ground, `passages` float64 (N, 5) between them, and the cloud that was seen there; all in one frame."""

    levels: tuple[KnownLevel, ...]
    passages: NDArray[np.float64]
    cloud: CloudMap

    def ground(self) -> KnownGround:
        """Return the ground for one robot."""
        return KnownGround(self.levels, self.passages)


def is_site(map_file: Path) -> bool:
    """Say whether levels of ground lie beside a map's YAML."""
    return _beside(map_file, LEVELS_SUFFIX).exists()


def load_site(map_file: Path, config: CloudMapConfig | None = None) -> SavedSite:
    """Read what lies beside a map's YAML; raises BadInputError that names what is missing or not whole."""
    levels = load_levels(_beside(map_file, LEVELS_SUFFIX))
    cloud = _beside(map_file, CLOUD_SUFFIX)
    if not cloud.exists():
        raise BadInputError(f"{cloud}: is missing; without the cloud of the site a robot cannot find out where it is")
    passages = load_passages(_beside(map_file, LEVELS_SUFFIX))
    site = SavedSite(tuple(KnownLevel(*level) for level in levels), passages, CloudMap.load(cloud, config))
    site.ground()  # raises where passages lead nowhere
    return site


def copy_site(map_file: Path, stem: Path) -> None:
    """Copy a site, for the folder of a run."""
    for suffix in (LEVELS_SUFFIX, CLOUD_SUFFIX):
        shutil.copyfile(_beside(map_file, suffix), stem.with_name(stem.name + suffix))


def check_places(site: SavedSite, start: SE2 | None, goals: Sequence[tuple[SE2, int | None]], name: str) -> None:
    """Raise BadInputError, which begins with `name`, for a start that is not on the ground of any level, and for goals outside of all or of their own."""
    ground = site.ground()
    if start is not None and ground.level_at(start) is None:
        raise BadInputError(f"{name}: the start pose {start.x:g}, {start.y:g} m does not lie on its ground")
    for goal, level in goals:
        if level is not None and not 0 <= level < len(site.levels):
            raise BadInputError(f"{name}: has no level {level}, it has {len(site.levels)}")
        own = site.levels if level is None else (site.levels[level],)
        if not any(each.spec.contains(goal.x, goal.y) for each in own):
            raise BadInputError(f"{name}: the goal {goal.x:g}, {goal.y:g} m lies outside of it")


def _beside(map_file: Path, suffix: str) -> Path:
    return map_file.with_name(map_file.stem + suffix)
