"""How well merged clouds tell where a dock is: looks from before it, the robot standing and moving, as the docking node takes them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.apps.docks import docks_of_world
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.detection import DockDetector, DockObservation
from ambler.evaluation.docking import DetectionErrors
from ambler.nodes.dock_sight import detector_of
from ambler.perception.merger import MergerConfig, MergeResult, ScanMerger
from ambler.perception.scanner_profile import ScannerCalibrations, calibrated_robot
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.world_file import load_world

STEP_NS = 10_000_000
STEPS = 24  # per look that is wanted, three times as many as clouds need: an unseen dock ends the series
SERIES = {
    "dock_still": (-1.0, BodyVelocity()),
    "dock_moving": (-1.0, BodyVelocity(-0.1, 0.02, 0.0)),
    "dock_half_metre": (-0.5, BodyVelocity()),
    "dock_contact": (0.0, BodyVelocity()),
}
"""Metres from the docked pose at which a series begins, and the velocity."""


def measure_scan_detections(
    seed: int, looks: int, world: str, robot: str, name: str, scanners: ScannerCalibrations
) -> list[DetectionErrors]:
    """Return the errors of a dock that scanners recognize, cloud by cloud, in series from three distances; a series
    in which it was never seen is left out. `scanners` are calibrated ones of the robot."""
    series = []
    for k, (title, (x, velocity)) in enumerate(SERIES.items()):
        errors = _errors(seed + k, looks, world, robot, name, SE2(x, 0.0, 0.0), velocity, scanners)
        series += [DetectionErrors(title, errors)] if len(errors) else []
    return series


def _errors(
    seed: int,
    looks: int,
    world: str,
    robot: str,
    name: str,
    dock_from_base: SE2,
    velocity: BodyVelocity,
    scanners: ScannerCalibrations,
) -> NDArray[np.float64]:
    """Return the errors (looks, 3) of the dock's pose in its own frame, millimetres and degrees; fewer where it was not seen."""
    plan, device = load_world(world), robot_named(robot)
    dock = docks_of_world(plan, Path("unsaved")).dock(name)
    world_from_dock = dock.map_from_dock  # the database was drawn in the world's frame
    sim = Simulation(plan, device, SimulationConfig(seed), world_from_dock @ dock_from_base)
    model = calibrated_robot(device.model, scanners)
    detector = detector_of(dock, model, None)
    merger = ScanMerger(MergerConfig.from_robot(model))
    errors: list[list[float]] = []
    for k in range(STEPS * looks):
        if len(errors) == looks:
            break
        sim.command(velocity)
        now_ns = (k + 1) * STEP_NS
        out = sim.step(now_ns)
        for odometry in out.odometry:
            merger.odometry.add(odometry)
        for scan in out.scans:
            merger.add_scan(scan, now_ns)
        if merger.is_due(now_ns):
            error = _error(sim, merger.merge(now_ns), detector, world_from_dock)
            errors += [] if error is None else [error]
    return np.array(errors).reshape(-1, 3)


def _error(sim: Simulation, merged: MergeResult, detector: DockDetector, world_from_dock: SE2) -> list[float] | None:
    cloud = merged.cloud
    world_from_base = sim.pose_at(cloud.stamp_ns).to_se2()
    points = cloud.points[:, :2].astype(np.float64)
    observation = DockObservation(cloud.stamp_ns, None, points, cloud.intensity)
    seen = detector.detect(observation, world_from_base.inverse() @ world_from_dock)
    if seen is None:
        return None
    away = (world_from_base @ seen.base_from_dock).inverse() @ world_from_dock
    return [-1e3 * away.x, -1e3 * away.y, -math.degrees(wrap_angle(away.yaw))]
