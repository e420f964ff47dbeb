"""`ambler calibrate camera PICTURES…`: a camera from pictures of a checkerboard, saved as ROS's `camera_info` YAML."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ambler.calibration.camera_calibration import Checkerboard

SIMULATED = 20


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what only cameras need."""
    group = parser.add_argument_group("calibrate camera")
    group.add_argument("pictures", type=Path, nargs="*", metavar="PICTURE", help="pictures of one checkerboard")
    group.add_argument("--board", default="7x5", metavar="CxR", help="inner corners along and across (default: 7x5)")
    group.add_argument("--square", type=float, default=0.04, help="side of a square in metres (default: 0.04)")
    group.add_argument("--name", default="camera", help="name of the camera (default: camera)")


def run(args: argparse.Namespace) -> int:
    """Calibrate, print, save. 2 when the pictures cannot be used."""
    from ambler.calibration.camera_calibration import calibrate_camera
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.wire.camera_info import save_camera_info

    if args.simulated == bool(args.pictures):
        raise BadInputError("give either pictures of a checkerboard or --simulated")
    if args.profile or args.set:
        raise BadInputError("--profile and --set: a camera is calibrated without settings of the robot")
    begin = time.perf_counter()
    board = _board(args.board, args.square)
    images = _simulated(board, args.seed) if args.simulated else [read_picture(path) for path in args.pictures]
    done = calibrate_camera(args.name, images, board)
    save_camera_info(args.out, done.camera)
    c = done.camera
    print(f"{c.name}: {c.width} x {c.height}, f {c.fx:.2f} x {c.fy:.2f} ± {done.focal_sigma_px:.2f} px,")
    print(f"centre {c.cx:.2f}, {c.cy:.2f}; {len(done.used)} of {len(images)} pictures, {done.error_px:.3f} px RMS")
    print(f"camera_info: {args.out}")
    fields: dict[str, Any] = {
        "pictures": len(images),
        "pictures_used": len(done.used),
        "error_rms_px": done.error_px,
        "focal_px": 0.5 * (c.fx + c.fy),
        "focal_sigma_px": done.focal_sigma_px,
    }
    if args.simulated:
        fields["focal_error_px"] = _focal_error(c.fx, c.fy)
    if args.json:
        what = f"--simulated --seed {args.seed}" if args.simulated else " ".join(str(p) for p in args.pictures)
        command = f"ambler calibrate camera {what} --out {args.out}"
        write_results(args.json, command, args.seed, time.perf_counter() - begin, fields)
    return 0


def _board(text: str, square: float) -> Checkerboard:
    from ambler.calibration.camera_calibration import Checkerboard
    from ambler.core.errors import BadInputError

    numbers = text.split("x")
    if len(numbers) != 2 or not all(n.isdigit() and int(n) >= 3 for n in numbers):
        raise BadInputError(f"--board {text}: must be inner corners along and across, as in 7x5")
    if not 0.0 < square < 1.0:
        raise BadInputError(f"--square {square:g}: must be metres")
    return Checkerboard(int(numbers[0]), int(numbers[1]), square)


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Read a picture as grey, uint8 (H, W); raises BadInputError."""
    import cv2
    import numpy as np

    from ambler.core.errors import BadInputError

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if image is None:
        raise BadInputError(f"{path}: is no picture")
    return np.asarray(image, np.uint8)


def _simulated(board: Checkerboard, seed: int) -> list[NDArray[np.uint8]]:
    """Pictures of a board that somebody holds before the simulated camera: everywhere, tilted in all directions."""
    import numpy as np

    from ambler.core.se3 import SE3
    from ambler.sim.camera import CameraSpec, PrintCamera, checkerboard_print

    rng = np.random.default_rng(seed)
    camera = PrintCamera(CameraSpec(samples=2), rng)
    images = []
    for k in range(SIMULATED):
        x, y = 0.2 * (k % 3 - 1), 0.12 * (k // 3 % 3 - 1)
        z, roll, turn = (float(rng.uniform(a, b)) for a, b in ((0.45, 0.7), (-0.5, 0.5), (-0.55, 0.55)))
        pose = SE3.from_rpy((x, y, z), math.pi + roll, turn, 0.0)
        images.append(camera.take([SE3()], [checkerboard_print(board.columns, board.rows, board.square, pose)]))
    return images


def _focal_error(fx: float, fy: float) -> float:
    from ambler.sim.camera import FRONT_CAMERA

    error = max(abs(fx - FRONT_CAMERA.fx), abs(fy - FRONT_CAMERA.fy))
    print(f"against the truth: focal length {error:.2f} px off at worst")
    return error
