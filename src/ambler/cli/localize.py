"""`ambler localize RECORDING --map MAP`: where was the robot of a recording in a known map? From a given pose, or from nothing."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.recording_choices import add_choices, choices_of, parse_pose
from ambler.cli.results_output import check_targets
from ambler.cli.run_options import add_settings, profile_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ambler.core.grid import GridSpec


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "localize", help="find a recorded drive (CARMEN log, ROS 1 or ROS 2 bag) in a known map"
    )
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="as `ambler slam2d` reads them")
    parser.add_argument("--map", type=Path, required=True, metavar="MAP", help="map YAML, or the Wean Hall map (.dat)")
    parser.add_argument(
        "--pose",
        metavar="X,Y,YAW",
        help="where the robot starts in the map, metres and degrees (default: it finds out itself)",
    )
    parser.add_argument(
        "--unsupervised",
        action="store_true",
        help="with --pose: never give the pose up, for old maps that contradict every scan",
    )
    parser.add_argument("--localizer", choices=("tracker", "particles", "reflectors"), help="(default: tracker)")
    add_choices(parser)
    add_settings(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for trajectory.tum, map.png and report.html")
    parser.add_argument("--seed", type=int, default=0, help="of the particles (default: 0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Localize; 0 when a place was found and believed at the end of the recording."""
    import time
    from functools import partial

    import numpy as np

    from ambler.apps.config import recorded_config
    from ambler.apps.recorded_localization import localize_recording
    from ambler.apps.recorded_report import write_localization_report
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.recordings.scan_recording import open_recording
    from ambler.slam2d.lag_search import find_lag
    from ambler.slam2d.sweep_search import find_sweep
    from ambler.wire.tum import write_tum

    if args.unsupervised and args.pose is None:
        raise BadInputError("--unsupervised needs --pose: without supervision nobody searches the map")
    check_targets(args.json, args.out)
    config = recorded_config(profile_of(args)[0])
    config.check_localizer()
    choices = choices_of(args)
    start = None if args.pose is None else parse_pose("--pose", args.pose)
    spec, occupancy = _load(args.map)
    if start is not None and not spec.contains(start.x, start.y):
        raise BadInputError(f"{args.map}: the pose {start.x:g}, {start.y:g} m lies outside of it")
    recording = open_recording(args.recording, choices, find_sweep=find_sweep, find_lag=find_lag)
    for note in recording.notes:
        print(note)
    warm_up(imported_kernel_modules())
    localizer = partial(config.make_localizer, seed=args.seed)
    begin, cpu = time.perf_counter(), time.process_time()
    result = localize_recording(recording.scans, spec, occupancy, localizer, start, is_supervised=not args.unsupervised)
    data_seconds = max(recording.stamps) - min(recording.stamps)
    fields: dict[str, Any] = {
        "localizer": config.localizer,
        "scans": result.scans,
        "data_seconds": data_seconds,
        "real_time_factor": data_seconds / max(time.process_time() - cpu, 1e-9),
        "found_after_s": result.found_after,
        "believed_ratio": len(result.poses) / max(result.scans, 1),
        "times_lost": result.times_lost,
        "points_on_walls_ratio": result.points_on_walls_ratio,
        "largest_correction_m": result.largest_correction,
    }
    for name, value in fields.items():
        print(f"{name:24s} {value:10.3f}" if isinstance(value, float) else f"{name:24s} {value!s:>10s}")
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        write_tum(args.out / "trajectory.tum", (result.stamps_ns * 1e-9).astype(np.float64), result.poses)
        notes = recording.notes
        report = write_localization_report(args.out, args.recording, (spec, occupancy), result, fields, notes)
        print(f"report: {report}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if result.is_found_at_the_end else 1


def _load(path: Path) -> tuple[GridSpec, NDArray[np.int8]]:
    """Read a map with occupancy in percent; raises BadInputError."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.wire.map_files import load_map
    from ambler.wire.wean import read_wean_map

    if not path.exists():
        raise BadInputError(f"{path}: there is no such map")
    if path.suffix != ".dat":
        return load_map(path)
    wean = read_wean_map(path)
    percent = np.rint(100.0 * np.nan_to_num(wean.p_occupied)).astype(np.int8)
    return wean.spec, np.where(np.isnan(wean.p_occupied), -1, percent).astype(np.int8)
