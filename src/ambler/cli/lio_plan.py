"""`ambler lio --grid`: the plan for robots that navigate in 2-D, beside the cloud that it is cut out of."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.lio.cloud_grid import CloudGrid
    from ambler.lio.config import LioConfig
    from ambler.lio.offline import OfflineLio


@dataclass(frozen=True, slots=True)
class Plan:
    """What was cut; None and why where it could not be: the cloud is not lost for it."""

    grid: CloudGrid | None = None
    failure: str = ""

    def fields(self) -> dict[str, Any]:
        """Return areas, m², and the share of the way that leads over other storeys."""
        if self.grid is None:
            return {}
        cell = self.grid.spec.resolution**2
        return {
            "plan_free_m2": cell * int((self.grid.occupancy == 0).sum()),
            "plan_occupied_m2": cell * int((self.grid.occupancy == 100).sum()),
            "plan_left_out_ratio": self.grid.left_out,
        }

    def warnings(self) -> list[str]:
        """Return what whoever uses the plan should know, in words."""
        if self.failure:
            return [self.failure]
        if self.grid is not None and self.grid.left_out > 0.05:
            return [f"{100 * self.grid.left_out:.0f} % of the way leads over another storey than the plan shows"]
        return []

    def write(self, folder: Path) -> None:
        """Write map.pgm and map.yaml."""
        from ambler.wire.map_files import save_map

        if self.grid is not None:
            save_map(folder / "map", self.grid.spec, self.grid.occupancy)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the one option."""
    parser.add_argument(
        "--grid", action="store_true", help="write map.pgm and map.yaml for robots that navigate in 2-D, too"
    )


def cut(args: argparse.Namespace, result: OfflineLio, config: LioConfig) -> Plan:
    """Cut the plan out of the cloud where it was asked for."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.kernels.warmup import warm_up
    from ambler.lio.cloud_grid import cut_plan

    if not args.grid:
        return Plan()
    warm_up(["cloud_grid"])
    try:
        return Plan(cut_plan(result.cloud, np.array([pose.translation for pose in result.poses]), config.grid))
    except BadInputError as error:
        return Plan(failure=str(error))
