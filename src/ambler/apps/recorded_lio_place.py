"""What localization in a saved cloud made of a recording, as files: trajectory in the map, a picture, a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.evaluation.cloud_views import draw_cloud
from ambler.evaluation.report import Picture, Table, write_report
from ambler.evaluation.results import machine_class
from ambler.lio.localize_offline import LocalizedLio
from ambler.wire.trajectory_files import write_tum_3d


def write_place(
    folder: Path,
    recording: Path,
    cloud: Path,
    result: LocalizedLio,
    points: NDArray[np.float64],
    fields: Mapping[str, Any],
    notes: Sequence[str],
) -> None:
    """Write all files into a folder; `points` (N, 3) are the map's."""
    write_tum_3d(folder / "trajectory.tum", result.stamps_ns, result.poses)
    way = np.array([pose.translation for pose in result.poses]).reshape(-1, 3)
    picture = Picture(
        "The saved cloud from above, coloured by height, with the trajectory",
        draw_cloud(folder / "top.png", points.astype(np.float32), way),
    )
    shown = {
        "ended": "localized" if result.is_success else result.state.name.lower(),
        "text": "; ".join(result.warnings()),
        **fields,
        "recording": str(recording),
        "map": str(cloud),
    }
    write_report(
        folder,
        f"{recording.name}: localized in {cloud.name}",
        shown,
        [picture],
        [Table("What was read", ("from the recording",), tuple((note,) for note in notes))],
        subtitle=machine_class(),
        passed={"ended": result.is_success},
    )
