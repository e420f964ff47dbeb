"""`ambler calibrate`: where a robot's scanners sit and what their clocks are off, from a minute of driving, into its profile; `ambler calibrate
camera`, from pictures of a checkerboard; `range`, from pictures of a marker at taped distances; `reflectors`, from a recorded drive."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli import calibrate_camera, calibrate_range, calibrate_reflectors
from ambler.cli.run_options import add_settings, profile_of

if TYPE_CHECKING:
    from ambler.evaluation.calibration import CalibrationDrive
    from ambler.evaluation.robot_calibration import ScannerDrive
    from ambler.perception.scanner_profile import ScannerCalibration

SECTION = "scanners"
OTHERS: dict[str, Any] = {
    "camera": calibrate_camera,
    "range": calibrate_range,
    "reflectors": calibrate_reflectors,
}
"""What else can be calibrated, by the word that stands in the place of the recording."""


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "calibrate", help="scanners' mountings and clocks from a minute of driving, written into the robot's profile"
    )
    parser.add_argument(
        "recording",
        type=Path,
        nargs="?",
        metavar="RECORDING",
        help="bag or run recording of the drive; or one of the words `camera` or `range`, and pictures after it, or `reflectors`",
    )
    for word in OTHERS.values():
        word.add_options(parser)
    parser.add_argument(
        "--simulated", action="store_true", help="drive in simulation, scanners a little off their model"
    )
    parser.add_argument("--robot", default="amr_omni", help="built-in robot or URDF (default: amr_omni)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="profile to write, or to complete")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the simulated drive (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated drive (default: 0)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Estimate, print, save. 2 when the recording cannot be used, 1 when it does not tell a mounting."""
    other = OTHERS.get(str(args.recording))
    if other is not None:
        return int(other.run(args))
    from ambler.apps.config import recorded_config
    from ambler.calibration.scan_calibration import calibrate_scanners
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.evaluation.robot_calibration import read_drive, simulate_robot_drive
    from ambler.perception.scanner_profile import scanner_calibrations
    from ambler.settings.profiles import load_profile
    from ambler.sim.robots import robot_named
    from ambler.wire.mcap_reader import cut_off

    if args.simulated == (args.recording is not None):
        raise BadInputError("give either a RECORDING or --simulated")
    config = recorded_config(profile_of(args)[0]).calibration
    begin = time.perf_counter()
    robot = robot_named(args.robot)
    if not robot.model.scanners:
        raise BadInputError(f"{args.robot} has no planar scanner to calibrate")
    if args.out.exists():
        load_profile(args.out)  # what could not be completed is refused before the work
    drive: CalibrationDrive | ScannerDrive
    if args.simulated:
        drive = simulate_robot_drive(robot, args.seed, args.seconds)
    else:
        for note in cut_off(args.recording):
            print(note)
        drive = read_drive(args.recording, robot)
    result = calibrate_scanners(drive.scans, drive.odometry, drive.scanners, drive.model, config)
    found = scanner_calibrations(result.scanners)
    fields: dict[str, Any] = {"robot": args.robot, "pairs": result.pairs, "residual_rms_mm": 1e3 * result.residual_rms}
    for frame, calibration in found.items():
        print(_told(frame, calibration))
        fields |= _fields(frame, calibration)
    if args.simulated:
        fields |= _errors(found, drive)
    source = "a simulated drive" if args.simulated else str(args.recording)
    _save(args.out, found, f"scanners calibrated from {source}")
    print(f"profile: {args.out}")
    if args.simulated:
        print(
            "this drive's scanners sat a little beside the model; a demo's sit exactly there, so do not use it for one"
        )
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0


def _told(frame: str, c: ScannerCalibration) -> str:
    return (
        f"{frame}: x {c.x:.4f} ± {1e3 * c.sigma_x:.1f} mm, y {c.y:.4f} ± {1e3 * c.sigma_y:.1f} mm,"
        f" yaw {math.degrees(c.yaw):.3f} ± {math.degrees(c.sigma_yaw):.3f}°,"
        f" clock {1e3 * c.clock_offset:+.1f} ± {1e3 * c.sigma_clock_offset:.1f} ms"
    )


def _fields(frame: str, c: ScannerCalibration) -> dict[str, float]:
    return {
        f"{frame}.x_m": c.x,
        f"{frame}.y_m": c.y,
        f"{frame}.yaw_deg": math.degrees(c.yaw),
        f"{frame}.clock_offset_ms": 1e3 * c.clock_offset,
        f"{frame}.sigma_position_mm": 1e3 * math.hypot(c.sigma_x, c.sigma_y),
        f"{frame}.sigma_yaw_deg": math.degrees(c.sigma_yaw),
        f"{frame}.sigma_clock_offset_ms": 1e3 * c.sigma_clock_offset,
    }


def _errors(found: dict[str, ScannerCalibration], drive: Any) -> dict[str, float]:
    """Compare with the truth of a simulated drive."""
    from ambler.core.se2 import wrap_angle

    position, yaw, clock = [], [], []
    for scanner, mount, offset in zip(drive.scanners, drive.mounts, drive.offsets, strict=True):
        c = found[scanner.frame]
        position.append(1e3 * math.hypot(c.x - mount.x, c.y - mount.y))
        yaw.append(math.degrees(abs(wrap_angle(c.yaw - mount.yaw))))
        clock.append(1e3 * abs(c.clock_offset - offset))
    print(f"against the truth: {max(position):.2f} mm, {max(yaw):.3f}°, {max(clock):.2f} ms at worst")
    return {
        "position_error_max_mm": max(position),
        "yaw_error_max_deg": max(yaw),
        "offset_error_max_ms": max(clock),
    }


def _save(out: Path, found: dict[str, ScannerCalibration], heading: str) -> None:
    """Lay the scanners over what the profile holds; whole or not at all."""
    from ambler.settings.profiles import as_values

    calibrate_range.save_profile(out, {SECTION: as_values(found)}, heading)
