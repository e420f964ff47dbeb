"""The CMU Wean Hall log and map of the probabilistic robotics course (`robotdata1.log`, `wean.dat`; formats: datasets.md).

The log has centimetres and radians; `O x y theta t` is odometry, `L x y theta xl yl thetal r1 … r180 t` a laser scan with the
robot's and the laser's pose in the odometry frame, beams from right (-90°) to left. Values at and above 8183 cm are no return.
The map's values are the probability that a cell is free, -1 is unknown; its lines run along y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

BEAMS = 180
NO_RETURN_CM = 8183.0
RANGE_MAX = 81.8
LASER_FRAME = "laser"
_UNKNOWN = np.full((6, 6), np.nan)


@dataclass(frozen=True, slots=True)
class WeanLog:
    """The log in file order: odometry and scans; each scan is preceded by the odometry of its own instant."""

    messages: tuple[Odometry | LaserScan, ...]
    base_from_laser: SE2


@dataclass(frozen=True, slots=True)
class WeanMap:
    """The map: `p_occupied` float32 [iy, ix], NaN where unknown."""

    spec: GridSpec
    p_occupied: NDArray[np.float32]


def read_wean_log(path: Path | str) -> WeanLog:
    """Read a log; raises BadInputError that names the line."""
    path = Path(path)
    messages: list[Odometry | LaserScan] = []
    mounts: list[SE2] = []
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        try:
            values = np.array(fields[1:], np.float64)
        except ValueError:
            raise BadInputError(f"{path}:{number}: a field is not a number") from None
        if fields[0] == "O" and len(values) == 4:
            messages.append(_odometry(values[:3], values[3]))
        elif fields[0] == "L" and len(values) == 7 + BEAMS:
            messages.append(_odometry(values[:3], values[-1]))
            messages.append(_scan(values[6:-1], values[-1]))
            mounts.append(_pose(values[:3]).inverse() @ _pose(values[3:6]))
        else:
            raise BadInputError(
                f"{path}:{number}: is neither `O x y theta t` nor `L` with {BEAMS} ranges ({fields[0]!r}, {len(values)} numbers)"
            )
    if not mounts:
        raise BadInputError(f"{path}: holds no laser line")
    median = np.median([m.as_array() for m in mounts], axis=0)
    return WeanLog(tuple(messages), SE2.from_array(median))


def read_wean_map(path: Path | str) -> WeanMap:
    """Read a map; raises BadInputError."""
    path = Path(path)
    resolution_cm, size, rows = 0.0, (0, 0), []
    lines = iter(_read_text(path).splitlines())
    for line in lines:
        fields = line.split()
        try:
            if len(fields) == 2 and fields[0].endswith("->resolution"):
                resolution_cm = float(fields[1])
            elif line.startswith("global_map[0]:"):
                size = (int(fields[2]), int(fields[1]))
                break
        except (ValueError, IndexError):
            raise BadInputError(f"{path}: a header line is not as it should be: {line.strip()!r}") from None
    if resolution_cm <= 0 or min(size) <= 0:
        raise BadInputError(f"{path}: no `…->resolution` and `global_map[0]: ny nx` lines")
    for number, line in enumerate(lines, start=1):
        if line.strip():
            try:
                row = np.array(line.split(), np.float32)
            except ValueError:
                raise BadInputError(f"{path}: map line {number}: a value is not a number") from None
            if len(row) != size[1]:
                raise BadInputError(f"{path}: map line {number} has {len(row)} values, not {size[1]}")
            rows.append(row)
    if len(rows) != size[0]:
        raise BadInputError(f"{path}: {len(rows)} map lines, not {size[0]}")
    p_free = np.array(rows).T
    p_occupied = np.where(p_free < 0, np.float32(np.nan), 1 - p_free).astype(np.float32)
    spec = GridSpec(resolution_cm / 100, size[0], size[1], 0.0, 0.0)
    return WeanMap(spec, np.ascontiguousarray(p_occupied))


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadInputError(f"{path}: is not a text file") from error


def _pose(values: NDArray[np.float64]) -> SE2:
    return SE2(float(values[0]) / 100, float(values[1]) / 100, float(values[2]))


def _odometry(values: NDArray[np.float64], seconds: float) -> Odometry:
    pose = SE3.from_se2(_pose(values))
    none = (math.nan, math.nan, math.nan)
    return Odometry(round(seconds * 1e9), "odom", "base", pose, none, none, _UNKNOWN.copy(), _UNKNOWN.copy())


def _scan(ranges_cm: NDArray[np.float64], seconds: float) -> LaserScan:
    ranges = np.where(ranges_cm >= NO_RETURN_CM, np.inf, ranges_cm / 100).astype(np.float32)
    return LaserScan(
        round(seconds * 1e9),
        LASER_FRAME,
        angle_min=-math.pi / 2,
        angle_increment=math.pi / BEAMS,
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.02,
        range_max=RANGE_MAX,
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )
