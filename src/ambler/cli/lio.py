"""`ambler lio RECORDING --out DIR`: clouds and inertial measurements become a trajectory and a map in three dimensions."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli import lio_localize, lio_plan
from ambler.cli.results_output import check_targets, partial_folder
from ambler.cli.run_options import add_settings, profile_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ambler.core.se3 import SE3
    from ambler.evaluation.spatial_error import SpatialError
    from ambler.lio.config import LioConfig
    from ambler.lio.offline import OfflineLio
    from ambler.perception.air_filter import AirFilterConfig
    from ambler.recordings.cloud_folder import CloudFolder
    from ambler.recordings.cloud_recording import CloudRecording

    Recording = CloudRecording | CloudFolder

EXAMINED = 12.0  # s at the beginning that are looked at for wrong units, clocks and mounts


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "lio", help="map a recording of a 3-D LiDAR and an IMU (bag or folder of clouds)"
    )
    parser.add_argument(
        "recording",
        type=Path,
        metavar="RECORDING",
        help="ROS 1 bag, ROS 2 bag (folder, .db3, .mcap), KITTI folder, or a folder of .pcd, .ply or .bin files with times.txt and imu.txt",
    )
    parser.add_argument("--cloud-topic", metavar="NAME", help="bags: topic of the clouds, where there are several")
    parser.add_argument("--imu-topic", metavar="NAME", help="bags: topic of the IMU, where there are several")
    parser.add_argument(
        "--odom-topic", metavar="NAME", default="none", help="bags: topic of wheel odometry to use (default: none)"
    )
    parser.add_argument(
        "--no-imu", action="store_true", help="map with the LiDAR alone: less exact, and lost in quick motions"
    )
    parser.add_argument(
        "--mount",
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="the LiDAR in the IMU's frame, m and deg, where the recording lacks it",
    )
    parser.add_argument("--no-check", action="store_true", help="do not examine units, clocks and mount first")
    lio_localize.add_options(parser)
    lio_plan.add_options(parser)
    add_settings(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for trajectory, clouds, pictures and report"
    )
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="FILE",
        help="TUM file of the IMU's true poses to compare with; with --map they are in its frame",
    )
    parser.add_argument(
        "--peer", action="store_true", help="run kiss-icp on the same clouds and compare it, too (needs --truth)"
    )
    parser.add_argument(
        "--cell", type=float, default=0.1, help="one point of the cloud per this many metres (default: 0.1)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="recorded in the result; the method draws no random numbers"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, examine, map, compare, write; 1 when the filter lost its way or the map is not to be trusted, the recording was not mapped to its end, or the reference does not fit it."""
    import time

    from ambler.apps.config import recorded_config
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.studies.lio_peer import INSTALL, is_installed
    from ambler.wire.trajectory_files import read_tum_3d

    if args.map is not None:
        if args.grid:
            raise BadInputError("--grid cuts a plan out of what is mapped: not with --map")
        return lio_localize.run(args)
    if args.guess is not None:
        raise BadInputError("--guess needs --map")
    robot_config = recorded_config(profile_of(args)[0])
    config = _config(args, robot_config.lio)
    check_targets(args.json, args.out)
    if args.peer and (args.truth is None or not is_installed()):
        raise BadInputError("--peer needs --truth" if args.truth is None else INSTALL)
    if not 0.01 <= args.cell <= 10.0:
        raise BadInputError(f"--cell {args.cell}: between 0.01 and 10 metres")
    if args.truth is not None:
        read_tum_3d(args.truth)  # before hours of mapping
    begin = time.perf_counter()
    recording, mount, notes = _opened(args, config)
    cpu = time.process_time()
    result = _map(recording, config, mount, args.cell, robot_config.air)
    cpu_seconds = time.process_time() - cpu
    notes = (*notes, result.note)
    error, failure = None, ""
    try:
        error = _against_truth(args.truth, result, result.poses) if args.truth else None
    except BadInputError as beside:
        failure = str(beside)  # the map is not lost for it
    plan = lio_plan.cut(args, result, config)
    fields = _fields(result, cpu_seconds) | plan.fields() | (error.fields() if error is not None else {})
    if error is not None and args.truth:
        fields["odometry_start_rms_m"] = _against_truth(args.truth, result, result.odometry).start_rms_m
    if args.peer and error is not None:
        fields |= _peer(args.truth, recording, config, mount)
    _write(args, result, fields, notes, error, plan)
    _report(args.out, fields)
    doubts = [failure] if failure else error.warnings() if error is not None else []
    for warning in (*result.warnings(), *plan.warnings(), *doubts):
        print(f"warning: {warning}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 1 if failure or result.cut or not result.is_sure else 0


def _config(args: argparse.Namespace, config: LioConfig) -> LioConfig:
    """Lay the options over the configuration."""
    from dataclasses import replace

    if args.no_imu:
        config = replace(config, has_imu=False)
    if args.mount is not None:
        config = replace(config, imu_from_lidar=_parse_mount(args.mount))
    return config


def _parse_mount(text: str) -> tuple[float, float, float, float, float, float]:
    import math

    from ambler.core.errors import BadInputError

    try:
        x, y, z, roll, pitch, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInputError(f"--mount {text}: is not X,Y,Z,ROLL,PITCH,YAW (metres and degrees)") from None
    if not math.isfinite(x + y + z + roll + pitch + yaw):
        raise BadInputError(f"--mount {text}: a value is not finite")
    return (x, y, z, math.radians(roll), math.radians(pitch), math.radians(yaw))


def _opened(args: argparse.Namespace, config: LioConfig) -> tuple[Recording, SE3, tuple[str, ...]]:
    """Open, say what was found, refuse what cannot be mapped; returns the recording, imu_from_lidar and the notes."""
    from ambler.core.errors import BadInputError
    from ambler.core.se3 import SE3
    from ambler.kernels.warmup import warm_up
    from ambler.lio.doctor import examine, first_seconds
    from ambler.recordings.cloud_folder import open_cloud_folder
    from ambler.recordings.cloud_recording import NONE, CloudChoices, open_cloud_recording

    warm_up(["air", "inertial", "voxel_map"])
    path: Path = args.recording
    has_bag = not path.is_dir() or any(f.suffix in (".bag", ".mcap", ".db3", ".zstd") for f in path.iterdir())
    recording: Recording
    if has_bag:
        imu_topic = NONE if args.no_imu else args.imu_topic
        recording = open_cloud_recording(path, CloudChoices(args.cloud_topic, imu_topic, args.odom_topic))
    else:
        recording = open_cloud_folder(path)
    for note in recording.notes:
        print(note)
    if config.has_imu and recording.imu_topic is None:
        raise BadInputError(
            f"{path}: has no inertial measurements; record an IMU, name its topic with --imu-topic, or map with the LiDAR alone (--no-imu)"
        )
    notes = recording.notes
    if config.imu_from_lidar is not None:
        x, y, z, *angles = config.imu_from_lidar
        mount = SE3.from_rpy((x, y, z), *angles)
    elif recording.lidar_from_imu is not None:
        mount = recording.lidar_from_imu.inverse()
    else:
        mount = SE3()
        if config.has_imu:
            notes = (*notes, "the IMU's mount is not told (--mount): LiDAR and IMU are taken to be in one place")
            print(notes[-1])
    if config.has_imu and not args.no_check:
        diagnosis = examine(first_seconds(recording.scans(config.lidar_clock), EXAMINED), config, mount)
        if diagnosis.troubles:
            raise BadInputError(f"{path}: {'; '.join(diagnosis.troubles)} (--no-check maps it all the same)")
    return recording, mount, notes


def _map(recording: Recording, config: LioConfig, mount: SE3, cell: float, air: AirFilterConfig) -> OfflineLio:
    """Run with a progress bar and the time that is left."""
    from ambler.cli.scan_progress import scan_progress
    from ambler.lio.offline import run_offline
    from ambler.perception.air_filter import AirFilter

    base = imu_from_base(recording, mount)
    with scan_progress("mapping", recording.clouds) as on_scan:
        scans = recording.scans(config.lidar_clock)
        return run_offline(scans, config, mount, base, cell=cell, on_scan=on_scan, air=AirFilter(air))


def imu_from_base(recording: Recording, mount: SE3) -> SE3 | None:
    """Return where the base is in the IMU's frame, which wheel odometry needs; None where the recording does not tell."""
    return None if recording.base_from_lidar is None else mount @ recording.base_from_lidar.inverse()


def _peer(truth_file: Path, recording: Recording, config: LioConfig, mount: SE3) -> dict[str, Any]:
    """Run kiss-icp on all clouds; its errors, and milliseconds of processor time."""
    import numpy as np

    from ambler.evaluation.spatial_error import spatial_error
    from ambler.studies.lio_peer import KissIcp
    from ambler.wire.trajectory_files import read_tum_3d

    peer = KissIcp(config.scan.range_min, config.scan.range_max)
    imu_from_lidar = mount.inverse()
    poses = [(scan.end_ns, peer.update(scan.cloud) @ imu_from_lidar) for scan in recording.scans()]
    stamps_ns, truth = read_tum_3d(truth_file)
    gap = 2.5e-9 * float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    error = spatial_error(np.array([s for s, _ in poses]), [p for _, p in poses], stamps_ns, truth, max_gap=gap)
    return {
        "peer_kiss_ate_rms_m": error.ate_rms_m,
        "peer_kiss_start_rms_m": error.start_rms_m,
        "peer_kiss_update_median_ms": float(np.median(peer.ms)),
    }


def _against_truth(path: Path, result: OfflineLio, poses: Sequence[SE3]) -> SpatialError:
    import numpy as np

    from ambler.evaluation.spatial_error import spatial_error
    from ambler.wire.trajectory_files import read_tum_3d

    stamps_ns, truth = read_tum_3d(path)
    gap = 2.5e-9 * float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return spatial_error(result.stamps_ns, poses, stamps_ns, truth, max_gap=gap)


def _fields(result: OfflineLio, cpu_seconds: float) -> dict[str, Any]:
    import numpy as np

    seconds = 1e-9 * float(result.stamps_ns[-1] - result.stamps_ns[0])
    median = float(np.median(result.update_ms))
    return {
        "scans": result.scans,
        "poses": len(result.poses),
        "data_seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "hz_median": 1e3 / median if median > 0.0 else None,
        "update_median_ms": median,
        "update_p95_ms": float(np.percentile(result.update_ms, 95.0)),
        "path_length_m": result.path_length,
        "inlier_ratio": result.inlier_ratio,
        "residual_m": result.residual_m,
        "scans_degenerate": result.degenerate,
        "scans_lost": result.lost + sum(hole.scans for hole in result.holes if not hole.is_regained),
        "scans_contradicted": result.contradicted,
        "holes": len(result.holes),
        "scans_at_rest": result.at_rest,
        "imu_gaps": result.gaps,
        "loop_closures": len(result.links),
        "is_converged": result.is_converged,
        "loop_cpu_seconds": result.loop_seconds,
        "false_ratio": result.false_ratio,
        "points": len(result.cloud),
        "map_memory_mb": result.map_mb,
    }


def _write(
    args: argparse.Namespace,
    result: OfflineLio,
    fields: dict[str, Any],
    notes: Sequence[str],
    error: SpatialError | None,
    plan: lio_plan.Plan,
) -> None:
    """Write everything into the folder."""
    from ambler.apps.recorded_lio_report import write_lio

    with partial_folder(args.out) as folder:
        write_lio(folder, args.recording, result, fields, notes, error)
        plan.write(folder)


def _report(out: Path, fields: dict[str, Any]) -> None:
    print(
        f"{fields['poses']} of {fields['scans']} scans, {fields['data_seconds']:.0f} s and {fields['path_length_m']:.1f} m in"
        f" {fields['cpu_seconds']:.1f} s CPU ({fields['hz_median']:.0f} scans/s), {100 * fields['inlier_ratio']:.0f} % of the points on planes"
    )
    print(f"{fields['loop_closures']} loop closures in {fields['loop_cpu_seconds']:.1f} s CPU")
    if "start_rms_m" in fields:
        share = 100.0 * fields["start_rms_m"] / max(fields["path_length_m"], 1e-9)
        print(
            f"against the reference: {fields['start_rms_m']:.3f} m RMS from the start ({share:.3f} % of the way),"
            f" {fields['ate_rms_m']:.3f} m after the best rigid motion; {fields['odometry_start_rms_m']:.3f} m without loop closure"
        )
    print(f"written: {out}")
