"""The configuration of a robot in a known map: which localizer, from which sensors, and how it drives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ambler.apps.config import ExplorerConfig, for_robot
from ambler.core.errors import BadInputError
from ambler.core.robot import DriveKind, RobotModel
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Localizer
from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig
from ambler.localization.reflector_localizer import ReflectorConfig, ReflectorLocalizer
from ambler.localization.reflectors import ReflectorMap
from ambler.localization.surface_map import SurfaceMap
from ambler.missions.navigate import NavigationConfig
from ambler.nodes.localization import LocalizationNodeConfig


@dataclass(frozen=True, slots=True)
class KnownMapConfig:
    """`localizer` chooses one of the three below; `reflector_positions` (x, y) in the map frame are needed by the third. `driving` holds
    planner, costmaps, controller and gate; what only exploring needs in it is not used. `seed`: of the particles."""

    localizer: Literal["tracker", "particles", "reflectors"] = "tracker"
    localization: LocalizationNodeConfig = field(default_factory=LocalizationNodeConfig)
    tracker: GridTrackerConfig = field(default_factory=GridTrackerConfig)
    particles: ParticleFilterConfig = field(default_factory=ParticleFilterConfig)
    reflectors: ReflectorConfig = field(default_factory=ReflectorConfig)
    reflector_positions: tuple[tuple[float, float], ...] = ()
    seed: int = 0
    driving: ExplorerConfig = field(default_factory=ExplorerConfig)

    def make_localizer(self, surfaces: SurfaceMap) -> Localizer:
        """Build the chosen localizer for a map; raises BadInputError for reflectors without positions."""
        if self.localizer == "tracker":
            return GridTracker(surfaces, self.tracker)
        if self.localizer == "particles":
            return ParticleFilter(surfaces, self.particles, np.random.default_rng(self.seed))
        if not self.reflector_positions:
            raise BadInputError("the reflector localizer needs reflector_positions in the map frame")
        return ReflectorLocalizer(ReflectorMap.surveyed(np.array(self.reflector_positions)), self.reflectors)


def known_map_config(robot: RobotModel) -> KnownMapConfig:
    """Return the defaults for a robot: its motion model; patience where people may block the way; the pursuit controller on an
    omnidirectional base with planar scanners."""
    driving = replace(for_robot(robot), navigation=NavigationConfig(blocked_patience=30.0))
    is_omni = robot.drive is DriveKind.OMNI
    if is_omni and robot.scanners:
        driving = replace(driving, controller="pursuit")
    return KnownMapConfig(particles=ParticleFilterConfig(drive=robot.drive), driving=driving)
