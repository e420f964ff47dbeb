"""A real IMU: what its rates add up to is how the published trajectory turned (docs/datasets.md)."""

from __future__ import annotations

import numpy as np

from ambler.kernels import inertial as k
from ambler.lio.state import FilterState, log
from ambler.wire.trajectory_files import read_tum_3d
from tests.public_data import public


def test_a_real_gyroscope_turns_as_the_published_trajectory() -> None:
    folder = public("imu_deskew")
    rows = np.loadtxt(folder / "imu.txt")
    samples = rows[:, [0, 4, 5, 6, 1, 2, 3]]
    stamps_ns, poses = read_tum_3d(folder / "traj.txt")
    stamps = stamps_ns * 1e-9
    told, summed = [], []
    for a in range(10, len(stamps) - 10, 10):
        b = a + 10
        part = samples[(samples[:, 0] >= stamps[a]) & (samples[:, 0] <= stamps[b])]
        if len(part) < 90:
            continue
        state, knots = FilterState(), np.empty((len(part), k.KNOT))
        k.propagate(
            *(np.ascontiguousarray(part), state.position, state.rotation, state.velocity, state.gyro_bias),
            *(state.accel_bias, state.gravity, np.eye(17), np.ones(4), knots),
        )
        covered = (part[-1, 0] - part[0, 0]) / (stamps[b] - stamps[a])
        turn = (poses[a].inverse() @ poses[b]).matrix()[:3, :3]
        told.append(covered * float(np.linalg.norm(log(turn))))
        summed.append(float(np.linalg.norm(log(state.rotation))))
    differences = np.degrees(np.abs(np.array(told) - np.array(summed)))
    turning = np.array(told) > np.radians(5.0)
    assert turning.sum() > 20
    # The mount between IMU and trajectory is unknown, so that only the size of a turn can be compared.
    assert np.median(differences[turning]) < 0.5
