"""The peer of LiDAR-inertial odometry: `kiss-icp` (an extra for benchmarks) on the same scans, one thread, with its own defaults."""

from __future__ import annotations

import importlib.util
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import PointCloud
from ambler.core.se3 import SE3
from ambler.lio.state import to_se3

INSTALL = "kiss-icp is not installed: pip install 'ambler[bench]'"


def is_installed() -> bool:
    """Say whether the peer can be measured."""
    return importlib.util.find_spec("kiss_icp") is not None


class KissIcp:
    """Runs the peer; `update` returns the pose of the LiDAR in its map, and `ms` (processor time) grows by an entry per scan."""

    def __init__(self, range_min: float, range_max: float) -> None:
        try:
            module, settings = importlib.import_module("kiss_icp.kiss_icp"), importlib.import_module("kiss_icp.config")
        except ImportError as error:
            raise BadInputError(INSTALL) from error
        config = settings.KISSConfig()
        config.data.min_range, config.data.max_range = range_min, min(range_max, 100.0)
        config.mapping.voxel_size = config.data.max_range / 100.0  # its own default rule
        config.registration.max_num_threads = 1
        self._odometry: Any = module.KissICP(config)
        self.ms: list[float] = []

    def update(self, cloud: PointCloud) -> SE3:
        """Register a cloud."""
        points = cloud.points.astype(np.float64)
        late = cloud.time.astype(np.float64)
        span = float(late.max() - late.min()) if len(late) else 0.0
        shares: NDArray[np.float64] = (late - late.min()) / span if span > 0.0 else np.zeros(0)  # none: no deskewing
        begin = time.process_time()
        self._odometry.register_frame(points, shares)
        self.ms.append(1e3 * (time.process_time() - begin))
        pose = np.asarray(self._odometry.last_pose, np.float64)
        return to_se3(pose[:3, 3], pose[:3, :3])
