"""Camera calibrations as ROS's `camera_info` YAML (camera_calibration_parsers)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole
from ambler.wire.yaml_text import read_yaml

MODELS = {"plumb_bob": 5, "rational_polynomial": 8}


def save_camera_info(path: Path, camera: CameraModel) -> None:
    """Write a calibration, atomically."""
    model = {count: name for name, count in MODELS.items()}[len(camera.distortion)]
    k = camera.matrix
    table = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": _matrix(3, 3, k.reshape(-1).tolist()),
        "distortion_model": model,
        "distortion_coefficients": _matrix(1, len(camera.distortion), list(camera.distortion)),
        "rectification_matrix": _matrix(3, 3, np.eye(3).reshape(-1).tolist()),
        "projection_matrix": _matrix(3, 4, np.column_stack((k, np.zeros(3))).reshape(-1).tolist()),
    }
    write_whole(path, yaml.safe_dump(table, sort_keys=False, default_flow_style=None))


def load_camera_info(path: Path) -> CameraModel:
    """Read a calibration; raises BadInputError, also for one that was never calibrated (a focal length of zero)."""
    try:
        table = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInputError(f"{path}: cannot be read as YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(table, dict):
        raise BadInputError(f"{path}: is no camera_info (a table with camera_matrix)")
    width, height = (_size(path, table, key) for key in ("image_width", "image_height"))
    fx, skew, cx, _, fy, cy, *_ = _numbers(path, table, "camera_matrix", 9)
    if fx <= 0.0 or fy <= 0.0:
        raise BadInputError(f"{path}: the camera is not calibrated (a focal length of {min(fx, fy):g})")
    if skew != 0.0:
        raise BadInputError(f"{path}: a camera with skew is not supported")
    model = str(table.get("distortion_model", "plumb_bob"))
    if model not in MODELS:
        raise BadInputError(f"{path}: distortion model {model!r} is not supported, only {', '.join(MODELS)}")
    distortion = _numbers(path, table, "distortion_coefficients", MODELS[model])
    return CameraModel(str(table.get("camera_name", "camera")), width, height, fx, fy, cx, cy, tuple(distortion))


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": data}


def _size(path: Path, table: dict[Any, Any], key: str) -> int:
    value = table.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value <= 0:
        raise BadInputError(f"{path}: {key} must be a positive whole number, not {value!r}")
    return value


def _numbers(path: Path, table: dict[Any, Any], key: str, count: int) -> list[float]:
    part = table.get(key)
    data = part.get("data") if isinstance(part, dict) else None
    if not isinstance(data, list) or len(data) != count:
        raise BadInputError(f"{path}: {key} must have {count} numbers in `data`")
    try:
        numbers = [float(v) for v in data]
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: {key} holds something that is no number") from error
    if not np.isfinite(numbers).all():
        raise BadInputError(f"{path}: {key} holds values that are not finite")
    return numbers
