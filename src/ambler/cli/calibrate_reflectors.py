"""`ambler calibrate reflectors --survey RECORDING`: where reflectors hang, from a drive of a robot that was localized otherwise, into its profile."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what only reflectors need."""
    group = parser.add_argument_group("calibrate reflectors")
    group.add_argument("--survey", type=Path, metavar="RECORDING", help="recording of a drive with poses in the map")


def run(args: argparse.Namespace) -> int:
    """Survey, print, save. 2 when the recording cannot be used."""
    import math

    from ambler.apps.config import recorded_config
    from ambler.apps.reflector_survey import survey_reflectors
    from ambler.cli.calibrate_range import save_profile
    from ambler.cli.run_options import profile_of
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.sim.robots import robot_named

    if args.survey is None:
        raise BadInputError("calibrate reflectors needs --survey RECORDING")
    begin = time.perf_counter()
    config = recorded_config(profile_of(args)[0])
    found = survey_reflectors(args.survey, robot_named(args.robot).model, config.reflectors.detector)
    positions = found.map.positions
    for (x, y), sigma in zip(positions.tolist(), found.map.sigmas.tolist(), strict=True):
        print(f"reflector at {x:.3f}, {y:.3f} m ± {1e3 * sigma:.1f} mm")
    values = {"reflector_positions": [[round(x, 4), round(y, 4)] for x, y in positions.tolist()]}
    save_profile(args.out, values, f"reflectors surveyed from {args.survey}")
    print(f"profile: {args.out}")
    fields: dict[str, Any] = {
        "reflectors": len(positions),
        "scans": found.scans,
        "scans_without_pose": found.without_pose,
        "sigma_max_m": float(found.map.sigmas.max()),
    }
    if args.json:
        fields["sigma_rms_m"] = math.sqrt(float((found.map.sigmas**2).mean()))
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0
