"""`ambler lio RECORDING --map CLOUD`: where was the sensor in a saved cloud? From a guess, or from nothing."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.core.se3 import SE3
    from ambler.lio.cloud_map import CloudMap
    from ambler.lio.config import LioConfig
    from ambler.lio.localize_offline import LocalizedLio
    from ambler.perception.air_filter import AirFilter


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what localization in a cloud can be told."""
    parser.add_argument(
        "--map", type=Path, metavar="CLOUD", help="localize in this saved cloud (.pcd, .ply) instead of mapping"
    )
    parser.add_argument(
        "--guess",
        metavar="X,Y,Z,YAW",
        help="with --map: where the IMU is at first, m and deg, within 2 m and 30° (default: it finds out itself)",
    )


def run(args: argparse.Namespace) -> int:
    """Localize and write; 0 when the place was found and is followed at the end, and the reference, if there is one, is of its times."""
    import time

    from ambler.apps.config import recorded_config
    from ambler.apps.recorded_lio_place import write_place
    from ambler.cli.lio import _config, _opened
    from ambler.cli.results_output import check_targets, partial_folder
    from ambler.cli.run_options import profile_of
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.lio.cloud_map import CloudMap
    from ambler.perception.air_filter import AirFilter
    from ambler.wire.trajectory_files import read_tum_3d

    if args.peer:
        raise BadInputError("--peer compares maps: not with --map")
    robot_config = recorded_config(profile_of(args)[0])
    config = _config(args, robot_config.lio)
    guess = parse_guess(args.guess)
    check_targets(args.json, args.out)
    if args.truth is not None:
        read_tum_3d(args.truth)
    begin, cpu = time.perf_counter(), time.process_time()
    cloud_map = CloudMap.load(args.map, config.localize.map)
    recording, mount, notes = _opened(args, config)
    result = _localized(recording, cloud_map, config, mount, guess, AirFilter(robot_config.air))
    fields = _fields(result) | {"map_points": len(cloud_map.points), "cpu_seconds": time.process_time() - cpu}
    failure = ""
    try:
        fields |= _against_truth(args.truth, result) if args.truth is not None else {}
    except BadInputError as beside:
        failure = str(beside)  # the trajectory is not lost for it
    notes = (*notes, result.note)
    with partial_folder(args.out) as folder:
        write_place(folder, args.recording, args.map, result, cloud_map.points, fields, notes)
    _report(args.out, fields)
    for warning in (*result.warnings(), *([failure] if failure else [])):
        print(f"warning: {warning}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if result.is_success and not result.cut and not failure else 1


def parse_guess(text: str | None) -> SE3 | None:
    """Return map_from_imu of X,Y,Z,YAW (m, deg); raises BadInputError."""
    from ambler.core.errors import BadInputError
    from ambler.core.se3 import SE3

    if text is None:
        return None
    try:
        x, y, z, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInputError(f"--guess {text}: is not X,Y,Z,YAW (metres and degrees)") from None
    if not math.isfinite(x + y + z + yaw):
        raise BadInputError(f"--guess {text}: a value is not finite")
    return SE3.from_rpy((x, y, z), 0.0, 0.0, math.radians(yaw))


def _localized(
    recording: Any, cloud_map: CloudMap, config: LioConfig, mount: SE3, guess: SE3 | None, air: AirFilter
) -> LocalizedLio:
    """Run with a progress bar and the time that is left."""
    from ambler.cli.lio import imu_from_base
    from ambler.cli.scan_progress import scan_progress
    from ambler.kernels.warmup import warm_up
    from ambler.lio.localize_offline import localize_offline

    warm_up(["cloud_search", "relocalization", "branch_bound"])
    base = imu_from_base(recording, mount)
    with scan_progress("localizing", recording.clouds) as on_scan:
        return localize_offline(
            recording.scans(config.lidar_clock), cloud_map, config, mount, base, guess=guess, on_scan=on_scan, air=air
        )


def _fields(result: LocalizedLio) -> dict[str, Any]:
    import numpy as np

    return {
        "success": result.is_success,
        "state": result.state.name,
        "found_after_s": result.found_after,
        "found_cpu_s": result.found_cpu,
        "scans": result.scans,
        "poses": len(result.poses),
        "times_lost": result.lost,
        "quality_median": float(np.median(result.qualities)) if len(result.qualities) else None,
        "localize_mean_ms": float(np.mean(result.update_ms)),
    }


def _against_truth(path: Path, result: LocalizedLio) -> dict[str, Any]:
    """Return the distances from true poses in the map's frame, nothing aligned. Raises BadInputError when no pose has a truth."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.evaluation.spatial_error import truth_at
    from ambler.lio.cloud_match import apart
    from ambler.wire.trajectory_files import read_tum_3d

    stamps_ns, truth = read_tum_3d(path)
    gap = 2.5e-9 * float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    pairs = [
        (pose, true)
        for stamp, pose in zip(result.stamps_ns.tolist(), result.poses, strict=True)
        if (true := truth_at(stamp, stamps_ns, truth, gap)) is not None
    ]
    if not pairs and result.poses:
        raise BadInputError(f"{path}: only 0 of {len(result.poses)} poses have a true pose at their time")
    if not pairs:
        return {"map_error_rms_m": None, "map_error_max_m": None, "map_error_rms_deg": None}
    off, turn = np.array([apart(true, pose) for pose, true in pairs]).T
    return {
        "map_error_rms_m": float(np.sqrt(np.mean(off**2))),
        "map_error_max_m": float(off.max()),
        "map_error_rms_deg": float(np.degrees(np.sqrt(np.mean(turn**2)))),
    }


def _report(out: Path, fields: dict[str, Any]) -> None:
    if fields["found_after_s"] is not None:
        print(
            f"found after {fields['found_after_s']:.1f} s of the recording and {fields['found_cpu_s']:.1f} s of computing;"
            f" {fields['poses']} of {fields['scans']} scans have a pose in the map"
        )
    if fields.get("map_error_rms_m") is not None:
        print(
            f"against the reference in the map: {fields['map_error_rms_m']:.3f} m RMS, at most {fields['map_error_max_m']:.3f} m,"
            f" {fields['map_error_rms_deg']:.2f}° RMS"
        )
    print(f"written: {out}")
