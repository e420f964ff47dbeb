"""What a KITTI raw drive tells beside its clouds (Geiger et al. 2013): inertial measurements in `oxts`, their mount in `calib_imu_to_velo.txt`, and when each sweep
of the scanner began and ended.

Of the thirty numbers of a measurement those along and about the axes of the IMU (x ahead, z up) are taken: forces from the twelfth, rates from the eighteenth on.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu
from ambler.core.se3 import SE3

F32 = NDArray[np.float32]
ReadTimes = Callable[[Path], NDArray[np.int64]]
SPACING_MOST = 0.03  # s between measurements: synchronized drives have one for each scan, between which nobody knows how the sensor turned
NUMBERS = 23  # of a measurement, at least


def read_oxts(folder: Path, times_of: ReadTimes) -> tuple[tuple[Imu, ...], str]:
    """Return the inertial measurements of a drive's `oxts` folder and what to tell of them; none where they come too seldom. Raises BadInputError."""
    files = sorted((folder / "data").glob("*.txt"))
    stamps = times_of(folder / "timestamps.txt")
    if len(stamps) != len(files):
        raise BadInputError(f"{folder}: {len(stamps)} times for {len(files)} measurements")
    if len(files) < 2:
        return (), f"{len(files)} of oxts"
    spacing = float(np.median(np.diff(stamps))) * 1e-9
    if not 0.0 < spacing <= SPACING_MOST:
        return (), f"those of oxts are {spacing:.2g} s apart, too seldom to follow a LiDAR with, and are left out"
    return tuple(_measurement(f, int(s)) for f, s in zip(files, stamps, strict=True)), f"{len(files)} of oxts"


def _measurement(file: Path, stamp_ns: int) -> Imu:
    try:
        row = [float(word) for word in file.read_text(encoding="utf-8", errors="replace").split()]
    except (ValueError, OSError) as error:
        raise BadInputError(f"{file}: is no measurement: {error}") from error
    if len(row) < NUMBERS:
        raise BadInputError(f"{file}: a measurement has {NUMBERS} numbers and more, not {len(row)}")
    return Imu(stamp_ns, "imu", (row[17], row[18], row[19]), (row[11], row[12], row[13]))


def read_mount(path: Path) -> SE3 | None:
    """Return the pose of the IMU in the LiDAR's frame, as `calib_imu_to_velo.txt` of a drive or of its day tells it; None where there is none. Raises BadInputError."""
    file = next(
        (f for folder in (path, path.resolve().parent) if (f := folder / "calib_imu_to_velo.txt").exists()), None
    )
    if file is None:
        return None
    try:
        lines = [
            line.split(":", 1)
            for line in file.read_text(encoding="utf-8", errors="replace").splitlines()
            if ":" in line
        ]
        told = {name.strip(): words.split() for name, words in lines}
        turn = np.array(told["R"], np.float64).reshape(3, 3)
        x, y, z = (float(word) for word in told["T"])
    except (ValueError, KeyError, OSError) as error:
        raise BadInputError(f"{file}: tells no rotation R and translation T: {error}") from error
    if (
        not np.isfinite([x, y, z]).all()
        or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
        or np.linalg.det(turn) < 0.0
    ):
        raise BadInputError(f"{file}: R is no rotation, or T not finite")
    qx, qy, qz, qw = Rotation.from_matrix(turn).as_quat().tolist()
    return SE3((x, y, z), (qw, qx, qy, qz))


def read_sweeps(folder: Path, times_of: ReadTimes) -> NDArray[np.int64] | None:
    """Return when each sweep began and ended, ns (N, 2), of a `velodyne_points` folder; None where it does not tell. Raises BadInputError."""
    begins, ends = folder / "timestamps_start.txt", folder / "timestamps_end.txt"
    if not (begins.exists() and ends.exists()):
        return None
    begin, end = times_of(begins), times_of(ends)
    if len(begin) != len(end) or not ((end > begin) & (end - begin < 10**9)).all():
        raise BadInputError(
            f"{folder}: sweeps must end after they begin, and within a second ({begins.name}, {ends.name})"
        )
    return np.stack((begin, end), axis=1)


def times_in_sweep(points: F32, seconds: float) -> F32:
    """Return when each of the points (N, 3) was taken, s after the sweep's begin, float32 (N,): the scanner begins behind and turns clockwise, seen from above."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return np.asarray(seconds * 0.5 * (1.0 - azimuth / np.pi), np.float32)
