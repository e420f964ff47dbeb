"""Whether memory stays what it is: LiDAR-inertial odometry with loop closure along kilometres that nobody has seen, and a whole robot that drives for half an hour.

Each is measured in a process that has done nothing else, for memory that was used once and is free again would hide what grows. What the simulator holds is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import recorded_config
from ambler.apps.drive import DriveRun, drive_scene
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.core.se3 import SE3
from ambler.evaluation.process_memory import memory_mb, peak_memory_mb
from ambler.evaluation.spatial_error import spatial_error
from ambler.kernels.warmup import imported_kernel_modules, warm_up
from ambler.lio.loop_closure import LoopClosure
from ambler.lio.odometry import LidarInertialOdometry
from ambler.perception.air_filter import AirFilter
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import LIDARS, HandRig
from ambler.sim.site import draw_site

PARTS = 5  # of the time: memory may settle in the first, and the second is compared with the last
FLAT_MB = 25.0  # what may come between these: a trajectory and its graph, no points
PASSING_MB = 100.0  # what may come at any moment after the first part: a dozen clouds that matches keep ready
PERIOD = 10.0  # seconds between two looks
ROUNDS_BEFORE = (
    1.5  # of a drive, that do not count: from the second round on places are known, and matches keep what they need
)
WALK_SPEED = 2.7  # m/s, of somebody who runs: 5 km in half an hour


@dataclass(slots=True)
class MemoryLog:
    """The memory of this process over time; `look` is `memory_mb` except in tests."""

    look: Callable[[], float] = memory_mb
    seconds: list[float] = field(default_factory=list)
    held_mb: list[float] = field(default_factory=list)

    def note(self, now: float) -> None:
        """Look, when it is time."""
        if not self.seconds or now >= self.seconds[-1] + PERIOD:
            self.seconds.append(now)
            self.held_mb.append(self.look())

    def fields(self) -> dict[str, Any]:
        """Return by how much the last part of the time held more than the second (medians), and the most that came after the first."""
        seconds, held = np.array(self.seconds), np.array(self.held_mb)
        part = np.minimum(seconds * PARTS / seconds[-1], PARTS - 1).astype(np.int64)
        settled, last = float(np.median(held[part == 1])), float(np.median(held[part == PARTS - 1]))
        most = float(held[part > 0].max())
        return {
            "settled_mb": settled,
            "growth_mb": last - settled,
            "passing_mb": most - settled,
            "peak_memory_mb": peak_memory_mb(),
            "is_met": last - settled <= FLAT_MB and most - settled <= PASSING_MB,
        }


def measure_walk(length: float, lidar: str, seed: int) -> dict[str, Any]:
    """Carry a scanner once around a drawn site of about `length` metres, with odometry and loop closure."""
    site = draw_site(seed, length)
    path = HandPath(site.way, speed=WALK_SPEED, is_closed=site.is_closed)
    rig = HandRig(site.world, path, LIDARS[lidar], seed)
    config = recorded_config({})
    odometry = LidarInertialOdometry(config.lio, rig.told_mount, None, AirFilter(config.air))
    loops = LoopClosure(config.lio)
    warm_up(imported_kernel_modules())
    most = int(path.seconds / rig.lidar.period) + 1
    stamps, told, true = np.zeros(most, np.int64), np.zeros((most, 7)), np.zeros((most, 7))
    stamps[:], told[:], true[:] = -1, 0.0, 0.0  # touched, so that they are held from the start
    log, n, seconds = MemoryLog(), 0, 0.0
    for number, scan in enumerate(rig.scans()):
        seconds = number * rig.lidar.period
        log.note(seconds)
        result = odometry.update(CloudScan(scan.cloud, scan.imu, scan.odometry))
        if result is not None:
            loops.add(result)
            stamps[n], told[n], true[n] = scan.end_ns, _row(result.start_from_imu), _row(scan.world_from_imu)
            n += 1
    loops.finish()
    log.seconds.append(seconds)
    log.held_mb.append(log.look())
    fields = log.fields()
    error = spatial_error(stamps[:n], [_pose(row) for row in told[:n]], stamps[:n], [_pose(row) for row in true[:n]])
    return {
        "way_m": error.path_length_m,
        "seconds": seconds,
        "scans": n,
        **fields,
        "map_mb": odometry.map.memory_mb,
        "keyframes": len(loops.keyframes),
        "closures": len(loops.closures),
        "start_rms_m": error.start_rms_m,
        "end_m": error.end_m,
    }


def measure_drive(world: str, robot: str, seconds: float, seed: int, out: Path) -> dict[str, Any]:
    """Drive a robot round and round the world's own route, with everything that it has: odometry, loop closure, gate, recording; `seconds` count, after some rounds."""
    options = RunOptions(steps=(), world=world, robot=robot, seed=seed, port=None, physics="kinematic")
    scene = drive_scene(options, "built-in", None)
    before = ROUNDS_BEFORE * scene.route.length / scene.route.speed
    rounds = 1 + int((before + seconds) * scene.route.speed / scene.route.length)
    scene = replace(scene, route=replace(scene.route, points=scene.route.points * rounds))
    warm_up(imported_kernel_modules())
    run = DriveRun(options, scene, RunFolder.new(out, "bench-memory"))
    log = MemoryLog()
    guarded = run.executor.guarded

    def watched(context: Any, callback: Any) -> None:
        guarded(context, callback)
        now = 1e-9 * run.executor.now_ns - before
        if now >= 0.0:
            log.note(now)

    run.executor.guarded = watched  # type: ignore[method-assign]
    try:
        run.run(before + seconds)
        ended = run.ended_of(run.robot)
    finally:
        run.close()
    fields = log.fields()
    return {
        "seconds": 1e-9 * run.executor.now_ns - before,
        "seconds_before": before,
        **fields,
        "ended": ended,
        "is_met": fields["is_met"] and ended in ("time_limit", "succeeded"),
    }


def _row(pose: SE3) -> tuple[float, ...]:
    return (*pose.translation, *pose.rotation)


def _pose(row: np.ndarray[Any, np.dtype[np.float64]]) -> SE3:
    x, y, z, *rotation = row.tolist()
    qw, qx, qy, qz = rotation
    return SE3((x, y, z), (qw, qx, qy, qz))
