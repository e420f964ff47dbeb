"""What LiDAR-inertial odometry made of a recording, as files: trajectory, cloud, pictures, report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ambler.evaluation.cloud_views import draw_cloud
from ambler.evaluation.curves import draw_errors
from ambler.evaluation.report import Picture, Table, write_report
from ambler.evaluation.results import machine_class
from ambler.evaluation.spatial_error import SpatialError
from ambler.lio.offline import OfflineLio
from ambler.wire.cloud_files import write_cloud
from ambler.wire.trajectory_files import write_kitti, write_tum_3d

FILES = (
    "trajectory.tum",
    "trajectory.kitti",
    "odometry.tum",
    "cloud.pcd",
    "cloud.ply",
    "top.png",
    "side.png",
    "report.html",
)


def write_lio(
    folder: Path,
    recording: Path,
    result: OfflineLio,
    fields: Mapping[str, Any],
    notes: Sequence[str],
    error: SpatialError | None = None,
) -> None:
    """Write all files into a folder; `error` is that against a reference."""
    write_tum_3d(folder / "trajectory.tum", result.stamps_ns, result.poses)
    write_kitti(folder / "trajectory.kitti", result.poses)
    write_tum_3d(folder / "odometry.tum", result.stamps_ns, result.odometry)
    heights = result.cloud[:, 2]
    for name in ("cloud.pcd", "cloud.ply"):
        write_cloud(folder / name, result.cloud, heights)
    way = np.array([pose.translation for pose in result.poses])
    pictures = [
        Picture(
            "The cloud from above, coloured by height, with the trajectory and (orange) the loop closures",
            draw_cloud(folder / "top.png", result.cloud, way, links=result.links),
        ),
        Picture("From the side", draw_cloud(folder / "side.png", result.cloud, way, from_side=True)),
    ]
    if error is not None:
        path = draw_errors(folder / "error.png", error.stamps_ns, error.errors, int(error.stamps_ns[0]))
        pictures.append(Picture("Distance from the reference, first poses laid upon each other", path))
    shown = {"ended": "mapped", "text": "; ".join(result.warnings()), **fields, "recording": str(recording)}
    tables = [Table("What was read", ("from the recording",), tuple((note,) for note in notes))]
    write_report(
        folder,
        f"{recording.name}: mapped in three dimensions",
        shown,
        pictures,
        tables,
        subtitle=machine_class(),
        passed={"ended": result.lost == 0 and result.is_sure and result.is_converged},
    )
