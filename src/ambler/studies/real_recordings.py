"""Real recordings in three dimensions that are no drives: an IMU with a published trajectory, and two clouds whose relation is published.

The IMU is integrated as LiDAR-inertial odometry integrates it between scans, from the trajectory's pose and speed on, with no biases taken out;
the clouds are laid on one another as loop closure lays submaps. `kiss-icp` registers the same two clouds.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import PointCloud
from ambler.kernels import inertial
from ambler.lio.config import LoopConfig
from ambler.lio.state import FilterState, exp, log
from ambler.registration.submap_match import match_clouds, thin_cloud
from ambler.studies.lio_peer import KissIcp, is_installed
from ambler.wire.cloud_files import read_cloud
from ambler.wire.trajectory_files import read_tum_3d

F64 = NDArray[np.float64]
SPANS = (1, 10, 50)  # poses of 0.1 s over which the IMU leads alone
SPEED_SPAN = 2  # poses on each side of one that tell its speed
STARTS, START_M, START_DEG = 50, 1.0, 10.0  # drawn guesses of the relation, at most so far off
FOUND_M, FOUND_DEG = 0.05, 0.5  # from the published relation
CLOUD_RANGE = (0.5, 100.0)  # metres


@dataclass(frozen=True, slots=True, eq=False)
class LaidClouds:
    """Points (N, 3) of the target and of the source where the match lays it."""

    target: F64
    source: F64


def measure_inertial(folder: Path) -> dict[str, Any]:
    """Integrate `imu.txt` along stretches of `traj.txt`, which is that of the IMU; errors of attitude and place after 0.1, 1 and 5 s."""
    rows = _table(folder / "imu.txt", 7)
    samples = np.ascontiguousarray(rows[:, [0, 4, 5, 6, 1, 2, 3]])
    stamps_ns, poses = read_tum_3d(folder / "traj.txt")
    stamps = np.asarray(stamps_ns * 1e-9, np.float64)
    matrices = np.array([pose.matrix() for pose in poses])
    fields: dict[str, Any] = {"imu.samples": len(samples), "imu.seconds": float(stamps[-1] - stamps[0])}
    for span in SPANS:
        errors = np.array(
            [
                error
                for first in range(SPEED_SPAN, len(stamps) - span - SPEED_SPAN, max(1, span // 2))
                if (error := _led(samples, stamps, matrices, first, first + span)) is not None
            ]
        )
        name = f"imu.after_{100 * span}_ms"
        fields |= {
            f"{name}_runs": len(errors),
            f"{name}_rotation_deg_median": float(np.median(errors[:, 0])),
            f"{name}_rotation_deg_95": float(np.quantile(errors[:, 0], 0.95)),
            f"{name}_position_m_median": float(np.median(errors[:, 1])),
            f"{name}_position_m_95": float(np.quantile(errors[:, 1], 0.95)),
        }
    return fields


def _led(samples: F64, stamps: F64, matrices: F64, a: int, b: int) -> tuple[float, float] | None:
    """Return the errors (degrees, metres) of the IMU's way from pose a to pose b; None where samples are missing."""
    k, m = np.searchsorted(samples[:, 0], [stamps[a], stamps[b]])
    if k == 0 or m >= len(samples) or np.diff(samples[k - 1 : m + 1, 0]).max() > 0.05:
        return None
    part = np.vstack([_sample_at(samples, k, stamps[a]), samples[k:m], _sample_at(samples, m, stamps[b])])
    before, after = a - SPEED_SPAN, a + SPEED_SPAN
    state = FilterState()
    state.rotation[:] = matrices[a, :3, :3]
    state.position[:] = matrices[a, :3, 3]
    state.velocity[:] = (matrices[after, :3, 3] - matrices[before, :3, 3]) / (stamps[after] - stamps[before])
    inertial.propagate(
        *(part, state.position, state.rotation, state.velocity, state.gyro_bias, state.accel_bias),
        *(state.gravity, np.eye(17), np.ones(4), np.empty((len(part), inertial.KNOT))),
    )
    turn = log(matrices[b, :3, :3].T @ state.rotation)
    return float(np.degrees(np.linalg.norm(turn))), float(np.linalg.norm(state.position - matrices[b, :3, 3]))


def _sample_at(samples: F64, k: int, time: float) -> F64:
    """Return the sample between those at k - 1 and k, at a time."""
    share = (time - samples[k - 1, 0]) / (samples[k, 0] - samples[k - 1, 0])
    return np.asarray(samples[k - 1] + share * (samples[k] - samples[k - 1]))


def measure_pair(folder: Path, seed: int, config: LoopConfig | None = None) -> tuple[dict[str, Any], LaidClouds]:
    """Lay `source.ply` on `target.ply` from no guess and from drawn ones, beside kiss-icp; errors against `T_target_source.txt`."""
    source, target = (_points(folder / f"{name}.ply") for name in ("source", "target"))
    told = _table(folder / "T_target_source.txt", 4)
    config = config or LoopConfig()
    clouds = thin_cloud(target, config.cell), thin_cloud(source, config.cell)
    rng = np.random.default_rng(seed)
    found = match_clouds(*clouds, np.eye(4), config.reach)
    if found is None:
        raise BadInputError(f"{folder}: the clouds do not overlap")
    metres, degrees = _off(told, found.target_from_source)
    hits = 0
    for _ in range(STARTS):
        match = match_clouds(*clouds, told @ _drawn(rng), config.reach)
        if match is not None:
            off = _off(told, match.target_from_source)
            hits += off[0] <= FOUND_M and off[1] <= FOUND_DEG
    fields: dict[str, Any] = {
        "pair.points": len(source),
        "pair.position_error_m": metres,
        "pair.rotation_error_deg": degrees,
        "pair.overlap": found.overlap,
        "pair.residual_m": found.residual_m,
        "pair.starts": STARTS,
        "pair.starts_found": int(hits),
    }
    if is_installed():
        peer = KissIcp(*CLOUD_RANGE)
        poses = [peer.update(_cloud(points)).matrix() for points in (target, source)]
        metres, degrees = _off(told, np.linalg.inv(poses[0]) @ poses[1])
        fields |= {"peer_kiss_pair.position_error_m": metres, "peer_kiss_pair.rotation_error_deg": degrees}
    pose = found.target_from_source
    return fields, LaidClouds(target, source @ pose[:3, :3].T + pose[:3, 3])


def _drawn(rng: np.random.Generator) -> F64:
    """Draw a motion of at most START_M and START_DEG."""
    axes = rng.standard_normal((2, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    out = np.eye(4)
    out[:3, :3] = exp(np.radians(START_DEG) * rng.uniform() * axes[0])
    out[:3, 3] = START_M * rng.uniform() * axes[1]
    return out


def _off(told: F64, found: F64) -> tuple[float, float]:
    """Return how far (metres, degrees) a pose (4, 4) lies from another."""
    off = np.linalg.inv(told) @ found
    return float(np.linalg.norm(off[:3, 3])), float(np.degrees(np.linalg.norm(log(off[:3, :3]))))


def _points(path: Path) -> F64:
    table = read_cloud(path)
    points = np.column_stack([table[name] for name in ("x", "y", "z")]).astype(np.float64)
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _cloud(points: F64) -> PointCloud:
    n = len(points)
    zero = np.zeros(n, np.float32)
    return PointCloud(0, "lidar", points.astype(np.float32), zero, zero, np.zeros(n, np.uint16))


def _table(path: Path, columns: int) -> F64:
    try:
        table = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path}: cannot be read: {error}") from error
    if table.shape[1] < columns:
        raise BadInputError(f"{path}: {columns} columns are asked, there are {table.shape[1]}")
    return np.asarray(table[:, :columns], np.float64)
