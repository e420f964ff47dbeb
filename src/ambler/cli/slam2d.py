"""`ambler slam2d LOG --out DIR`: a recorded laser log becomes a map, a trajectory and a picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.recording_choices import add_choices, choices_of
from ambler.cli.results_output import check_targets, partial_folder
from ambler.cli.run_options import add_settings, profile_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ambler.evaluation.relations import RelationErrors
    from ambler.recordings.scan_recording import ScanRecording
    from ambler.slam2d.config import Slam2dConfig
    from ambler.slam2d.offline import OfflineResult

FILES = ("trajectory.tum", "map.pgm", "map.png", "map.yaml", "report.html")


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "slam2d", help="turn recorded laser scans (CARMEN log, ROS 1 or ROS 2 bag) into a map and a trajectory"
    )
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help="CARMEN log (plain, .gz, .bz2), Wean Hall log, ROS 1 bag, or ROS 2 bag (folder, .db3, .mcap)",
    )
    add_choices(parser)
    add_settings(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for " + ", ".join(FILES))
    parser.add_argument("--relations", type=Path, metavar="FILE", help="SLAM-benchmark relations to compare with")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="TUM file of reference poses to compare with")
    parser.add_argument(
        "--seed", type=int, default=0, help="recorded in the result; the method draws no random numbers"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, map, write, compare."""
    import time

    from ambler.apps.config import recorded_config
    from ambler.evaluation.relations import load_relations, relation_errors
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.recordings.scan_recording import open_recording
    from ambler.slam2d.lag_search import find_lag
    from ambler.slam2d.sweep_search import find_sweep

    config = recorded_config(profile_of(args)[0]).slam2d.slam
    check_targets(args.json, args.out)
    begin = time.perf_counter()
    import ambler.slam2d.offline  # noqa: F401  (names the kernels to warm up)

    warm_up(imported_kernel_modules())
    cpu = time.process_time()
    relations = load_relations(args.relations) if args.relations else None
    recording = open_recording(args.log, choices_of(args), find_sweep=find_sweep, find_lag=find_lag)
    for note in recording.notes:
        print(note)
    stamps = list(recording.stamps)
    result = _map(recording, config)
    errors = relation_errors(relations, stamps, result.poses) if relations else None
    cpu_seconds = time.process_time() - cpu
    data_seconds = max(stamps) - min(stamps)
    fields: dict[str, Any] = {
        "scans": len(stamps),
        "data_seconds": data_seconds,
        "cpu_seconds": cpu_seconds,
        "real_time_factor": data_seconds / cpu_seconds,
        "loop_closures": result.loop_closures,
        "nodes": result.nodes,
        "submaps": result.submaps,
        "points_on_walls_ratio": result.points_on_walls_ratio,
    }
    if errors is not None:
        fields |= errors.fields()
    if args.truth:
        fields |= _against_truth(args.truth, stamps, result)
    _write(args, stamps, result, fields, recording.notes, errors)
    _report(args.out, fields)
    for warning in result.warnings():
        print(f"warning: {warning}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0


def _against_truth(path: Path, stamps: list[float], result: OfflineResult) -> dict[str, Any]:
    """Compare with reference poses: those of the scans, by their stamps."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.evaluation.revisits import revisit_errors
    from ambler.evaluation.trajectory import trajectory_error, truth_at
    from ambler.wire.tum import read_tum

    truth_stamps, truth = read_tum(path)
    ns, truth_ns = (np.rint(np.asarray(s) * 1e9).astype(np.int64) for s in (stamps, truth_stamps))
    gap = 2.0 * float(np.median(np.diff(truth_stamps))) if len(truth_stamps) > 1 else 0.0
    errors = trajectory_error(ns, result.poses, truth_ns, truth, max_gap=gap)
    is_known, there = truth_at(ns, truth_ns, truth, gap)
    if not is_known.any():
        raise BadInputError(f"{path}: no reference pose at the time of a scan")
    fields = {"ate_rms_m": errors.ate_rms_m, "ate_max_m": errors.ate_max_m}
    return fields | revisit_errors(result.poses[is_known], there[is_known]).fields()


def _map(recording: ScanRecording, config: Slam2dConfig) -> OfflineResult:
    """Run with a progress bar and the time that is left."""
    from ambler.cli.scan_progress import scan_progress
    from ambler.slam2d.offline import run_offline

    with scan_progress("mapping", len(recording.stamps)) as on_scan:
        return run_offline(recording.scans, config, on_scan)


def _write(
    args: argparse.Namespace,
    stamps: list[float],
    result: OfflineResult,
    fields: dict[str, Any],
    notes: Sequence[str],
    errors: RelationErrors | None,
) -> None:
    """Write everything at once, or nothing."""
    import numpy as np

    from ambler.apps.recorded_report import write_mapping_report
    from ambler.wire.map_files import save_map
    from ambler.wire.tum import write_tum

    with partial_folder(args.out) as folder:
        write_tum(folder / "trajectory.tum", np.array(stamps), result.poses)
        save_map(folder / "map", result.spec, result.occupancy)
        write_mapping_report(folder, args.log, stamps, result, fields, notes, errors)


def _report(out: Path, fields: dict[str, Any]) -> None:
    print(
        f"{fields['scans']} scans, {fields['data_seconds']:.0f} s of data in {fields['cpu_seconds']:.1f} s CPU"
        f" ({fields['real_time_factor']:.0f} x real time), {fields['submaps']} submaps,"
        f" {fields['loop_closures']} loop closures, {100 * fields['points_on_walls_ratio']:.1f} % of the returns on walls"
    )
    if "relations_used" in fields:
        print(
            f"relations: {fields['relations_used']} used, translation {fields['translation_mean_m']:.4f} ±"
            f" {fields['translation_std_m']:.4f} m, rotation {fields['rotation_mean_deg']:.3f} ±"
            f" {fields['rotation_std_deg']:.3f} deg"
        )
    if "ate_rms_m" in fields:
        print(f"against the reference: {fields['ate_rms_m']:.3f} m RMS, {fields['ate_max_m']:.3f} m at worst", end="")
        median, worst = fields["revisit_error_median_m"], fields["revisit_error_worst_m"]
        print(f"; {fields['revisits']} revisits" + ("" if median is None else f": {median:.3f} m, worst {worst:.3f} m"))
    print(f"written: {', '.join(str(out / name) for name in FILES)}")
