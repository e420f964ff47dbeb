"""`ambler calibrate range PICTURE@METRES…`: how far a camera moves the edges of markers, with a tape measure; `--check` a marker of another size."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.calibration.range_bias import TapedPicture
    from ambler.core.camera import CameraModel, MarkerSpec

SETTING = "edge_shift_px"
SIMULATED = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25)  # taped metres
BLOOM = 0.3  # share of a pixel that the white of the simulated camera eats
TAPE_ZERO = 0.021  # metres by which the simulated tape begins before the optical centre


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what only ranges need."""
    group = parser.add_argument_group("calibrate range")
    group.add_argument("--camera", type=Path, metavar="FILE", help="calibration of the camera, a camera_info YAML")
    group.add_argument("--marker", metavar="DICT:ID:SIDE", help="the marker, as in 4X4_50:3:0.15 (side in metres)")
    group.add_argument(
        "--check", nargs="+", default=[], metavar="PICTURE@METRES", help="pictures of the marker of --check-marker"
    )
    group.add_argument("--check-marker", metavar="DICT:ID:SIDE", help="a marker of another size, for --check")


def run(args: argparse.Namespace) -> int:
    """Calibrate, check, print, save. 2 when the pictures cannot be used."""
    import numpy as np

    from ambler.calibration.range_bias import calibrate_range, check_range
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.perception.fiducials import FiducialDetector

    if args.simulated == bool(args.pictures):
        raise BadInputError("give either pictures with their distances, as in near.png@0.50, or --simulated")
    if bool(args.check) != bool(args.check_marker) or (args.check and args.simulated):
        raise BadInputError("--check and --check-marker belong together, and to real pictures")
    begin = time.perf_counter()
    camera, marker, pictures = _given(args) if not args.simulated else _simulated(args.seed)
    detector = FiducialDetector(camera, [marker])
    bias = calibrate_range(detector, pictures)
    print(f"edges are {bias.shift_px:.3f} ± {bias.shift_sigma_px:.3f} px farther in than seen, the tape began")
    print(f"{1e3 * bias.offset:.1f} mm before the optical centre; {1e3 * bias.residual:.1f} mm RMS remain")
    fields: dict[str, Any] = {
        "pictures": bias.pictures,
        "shift_px": bias.shift_px,
        "shift_sigma_px": bias.shift_sigma_px,
        "tape_offset_m": bias.offset,
        "residual_rms_m": bias.residual,
    }
    if args.check:
        other = FiducialDetector(camera, [_marker("--check-marker", args.check_marker)])
        taped = [_taped(text) for text in args.check]
        before, after = (check_range(d, taped, bias.offset) for d in (other, other.with_shift(bias.shift_px)))
        print(
            f"another marker: {1e3 * np.abs(before).max():.1f} mm off at worst before, {1e3 * np.abs(after).max():.1f} after"
        )
        fields |= {"check_before_max_m": float(np.abs(before).max()), "check_after_max_m": float(np.abs(after).max())}
    save_profile(args.out, {"docking": {SETTING: round(bias.shift_px, 4)}}, "edges of markers calibrated with a tape")
    print(f"profile: {args.out}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0


def save_profile(out: Path, values: dict[str, Any], heading: str) -> None:
    """Lay values over what a profile holds, or begin one; whole or not at all."""
    import yaml

    from ambler.core.errors import BadInputError
    from ambler.settings.profiles import load_profile, merge
    from ambler.wire.atomic_file import write_whole

    profile = load_profile(out) if out.exists() else {}
    text = yaml.safe_dump(merge(profile, values), sort_keys=False, allow_unicode=True)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, f"# {heading}\n{text}")
    except OSError as error:
        raise BadInputError(f"{out}: cannot be written: {error.strerror or error}") from error


def _given(args: argparse.Namespace) -> tuple[CameraModel, MarkerSpec, list[TapedPicture]]:
    from ambler.core.errors import BadInputError
    from ambler.wire.camera_info import load_camera_info

    if args.camera is None or args.marker is None:
        raise BadInputError("calibrate range needs --camera FILE and --marker DICT:ID:SIDE")
    pictures = [_taped(str(text)) for text in args.pictures]
    return load_camera_info(args.camera), _marker("--marker", args.marker), pictures


def _marker(option: str, text: str) -> MarkerSpec:
    from ambler.core.camera import MarkerSpec
    from ambler.core.errors import BadInputError

    try:
        dictionary, number, side = text.split(":")
        marker = MarkerSpec(dictionary, int(number), float(side))
    except ValueError as error:
        raise BadInputError(
            f"{option} {text}: must be dictionary, number and side in metres, as in 4X4_50:3:0.15"
        ) from error
    if not 0.005 < marker.size < 2.0:
        raise BadInputError(f"{option} {text}: a side of {marker.size:g} m cannot be meant")
    return marker


def _taped(text: str) -> TapedPicture:
    from ambler.calibration.range_bias import TapedPicture
    from ambler.cli.calibrate_camera import read_picture
    from ambler.core.errors import BadInputError

    path, _, metres = text.rpartition("@")
    try:
        distance = float(metres)
    except ValueError as error:
        raise BadInputError(
            f"{text}: must be a picture and its taped distance in metres, as in near.png@0.50"
        ) from error
    return TapedPicture(read_picture(Path(path)), distance)


def _simulated(seed: int) -> tuple[CameraModel, MarkerSpec, list[TapedPicture]]:
    """A marker before the simulated camera, whose bright parts eat dark ones, at distances taped to 2 mm."""
    import math

    import cv2
    import numpy as np

    from ambler.calibration.range_bias import TapedPicture
    from ambler.core.camera import MarkerSpec
    from ambler.core.se3 import SE3
    from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PrintCamera, marker_print

    rng, marker = np.random.default_rng(seed), MarkerSpec("4X4_50", 3, 0.15)
    camera, pictures = PrintCamera(CameraSpec(), rng), []
    for metres in SIMULATED:
        pose = SE3.from_rpy((0.01, 0.0, metres), math.pi, 0.2, 0.0)
        sharp = camera.take([SE3()], [marker_print(marker.dictionary, marker.number, marker.size, pose)])
        wide = cv2.dilate(sharp, np.ones((3, 3), np.uint8))
        image = np.asarray(cv2.addWeighted(sharp, 1.0 - BLOOM, wide, BLOOM, 0.0), np.uint8)
        pictures.append(TapedPicture(image, metres - TAPE_ZERO + float(rng.uniform(-0.002, 0.002))))
    return FRONT_CAMERA, marker, pictures
