"""Dense clouds of stations beside a map: `<stem>.stations.pcd`, all points in the map's frame, station after station, and the table `<stem>.stations.json`.

The table is written last: where it is, the cloud is whole. Poses are x, y, z (m) and a quaternion w, x, y, z.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.wire.atomic_file import write_whole
from ambler.wire.cloud_files import read_cloud, write_cloud

CLOUD_SUFFIX = ".stations.pcd"
TABLE_SUFFIX = ".stations.json"


@dataclass(frozen=True, slots=True, eq=False)
class StationCloud:
    """A station as it is saved: `points` float32 (N, 3) in the base at `stamp_ns`, with `intensity` float32 (N,); `density` is how many times as many points
    it has as one scan."""

    number: int
    stamp_ns: int
    level: int
    map_from_base: SE3
    seconds: float
    scans: int
    density: float
    points: NDArray[np.float32]
    intensity: NDArray[np.float32]


def save_stations(stem: Path, stations: Sequence[StationCloud], cell: float) -> None:
    """Write the stations of a map; `cell` (m) is the cube of which each holds one point. Raises NotWrittenError."""
    points, intensity = [np.zeros((0, 3), np.float32)], [np.zeros(0, np.float32)]
    rows, first = [], 0
    for s in stations:
        points.append(s.map_from_base.transform(s.points).astype(np.float32))
        intensity.append(s.intensity)
        rows.append(
            {
                "number": s.number,
                "stamp_ns": s.stamp_ns,
                "level": s.level,
                "map_from_base": [*s.map_from_base.translation, *s.map_from_base.rotation],
                "seconds": s.seconds,
                "scans": s.scans,
                "first_point": first,
                "points": len(s.points),
                "ratio_vs_one_scan": s.density,
            }
        )
        first += len(s.points)
    write_cloud(stem.with_name(stem.name + CLOUD_SUFFIX), np.concatenate(points), np.concatenate(intensity))
    table = {"frame": "map", "cell_m": cell, "points": first, "stations": rows}
    write_whole(stem.with_name(stem.name + TABLE_SUFFIX), json.dumps(table, indent=1) + "\n")


def load_stations(stem: Path) -> list[StationCloud]:
    """Return the stations that were saved beside a map, with their points in the base again; raises BadInputError that names the file and what is wrong."""
    path = stem.with_name(stem.name + TABLE_SUFFIX)
    table = read_cloud(stem.with_name(stem.name + CLOUD_SUFFIX))
    try:
        told = json.loads(path.read_text("utf-8"))
        if told["points"] != len(table):
            raise BadInputError(f"{path}: tells of {told['points']} points, its cloud has {len(table)}")
        return [_station(row, table) for row in told["stations"]]
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{path}: is no table of stations: {error}") from error


def _station(row: dict[str, object], table: NDArray[np.void]) -> StationCloud:
    numbers = [float(v) for v in np.array(row["map_from_base"], np.float64)]
    if len(numbers) != 7 or not all(map(math.isfinite, numbers)):
        raise ValueError("a pose has seven finite numbers")
    x, y, z, *(qw, qx, qy, qz) = numbers
    pose = SE3((x, y, z), (qw, qx, qy, qz))
    first, count = int(str(row["first_point"])), int(str(row["points"]))
    own = table[first : first + count]
    if len(own) != count:
        raise ValueError("a station has more points than there are")
    points = np.column_stack([own[axis] for axis in "xyz"]).astype(np.float64)
    return StationCloud(
        int(str(row["number"])),
        int(str(row["stamp_ns"])),
        int(str(row["level"])),
        pose,
        float(str(row["seconds"])),
        int(str(row["scans"])),
        float(str(row["ratio_vs_one_scan"])),
        pose.inverse().transform(points).astype(np.float32),
        np.asarray(own["intensity"], np.float32),
    )
