"""Map files of the ROS map servers: a YAML file with the geometry and thresholds beside an image whose first row is the top.

A pixel p becomes an occupancy o = (255 - p) / 255, or p / 255 when `negate` is set (colour channels averaged). Mode trinary:
o >= occupied_thresh is 100, o <= free_thresh is 0, else unknown, as are pixels that cannot be seen at all; scale: the middle maps linearly to
0 ... 100, transparent pixels are unknown; raw: the pixel is the occupancy, above 100 unknown. A picture that lies turned in its frame is drawn anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.wire.atomic_file import write_whole
from ambler.wire.turned_maps import straightened
from ambler.wire.yaml_text import read_yaml

PIXEL_FREE, PIXEL_OCCUPIED, PIXEL_UNKNOWN = 254, 0, 205
OCCUPIED_THRESH = 0.65
FREE_THRESH = 0.196  # just below the 50 / 255 of an unknown pixel; with 0.25 every map server reads unknown as free
SAVED_FREE, SAVED_OCCUPIED = 25, 65  # occupancies written as free and as occupied
PICTURES = (".png", ".pgm", ".pbm", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".gif")
_GREYS = np.arange(256, dtype=np.uint8).reshape(256, 1, 1)
MODES = ("trinary", "scale", "raw")


def save_map(
    stem: Path, spec: GridSpec, occupancy: NDArray[np.int8], bend: tuple[float, float] | None = None
) -> tuple[Path, Path]:
    """Write `<stem>.pgm` and `<stem>.yaml` as map_saver does (trinary, 0 / 254 / 205); the YAML appears last, both atomically.

    `occupancy` is int8 [iy, ix]: -1 unknown, 0 ... 100. `bend` says how far a made map is bent (m, rad; None: not known); other readers of
    such files pass over it. Returns the two paths.
    """
    if occupancy.shape != spec.shape:
        raise BadInputError(f"{stem}: the map is {occupancy.shape}, its geometry says {spec.shape}")
    pixels = np.full(occupancy.shape, PIXEL_UNKNOWN, np.uint8)
    pixels[(occupancy >= 0) & (occupancy <= SAVED_FREE)] = PIXEL_FREE
    pixels[occupancy >= SAVED_OCCUPIED] = PIXEL_OCCUPIED
    image = stem.with_name(stem.name + ".pgm")
    header = f"P5\n# resolution {spec.resolution:.6g} m\n{spec.width} {spec.height}\n255\n".encode("ascii")
    write_whole(image, header + np.ascontiguousarray(pixels[::-1]).tobytes())
    named = yaml.safe_dump({"image": image.name}, allow_unicode=True, width=math.inf)  # in quotes where YAML needs them
    text = (
        f"{named}mode: trinary\nresolution: {spec.resolution!r}\n"
        f"origin: [{spec.origin_x!r}, {spec.origin_y!r}, 0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    if bend is not None:
        text += f"bend: [{bend[0]:.5f}, {bend[1]:.6f}]\n"
    description = stem.with_name(stem.name + ".yaml")
    write_whole(description, text)
    return image, description


def load_map(yaml_path: Path) -> tuple[GridSpec, NDArray[np.int8]]:
    """Read a map by its YAML, or its image with the YAML beside it; returns its geometry and occupancy int8 [iy, ix], row 0 at the lowest y.

    Raises BadInputError.
    """
    return _load(yaml_path, _as_served)


def load_plan(yaml_path: Path) -> tuple[GridSpec, NDArray[np.int8]]:
    """Read a map as `load_map` does, but for what it was saved to say: map savers write 205 for unknown and, many of them, a free_thresh of
    0.25, with which map servers read that as free. Raises BadInputError."""
    return _load(yaml_path, _as_saved)


def _load(
    yaml_path: Path, interpret: Callable[[NDArray[np.uint8], _Description], NDArray[np.int8]]
) -> tuple[GridSpec, NDArray[np.int8]]:
    description = _read_description(yaml_path)
    occupancy = interpret(read_image(description.image), description)
    height, width = occupancy.shape
    spec = GridSpec(description.resolution, width, height, *description.origin)
    cells = np.ascontiguousarray(occupancy[::-1])
    return (spec, cells) if description.yaw == 0.0 else straightened(spec, cells, description.yaw)


def yaml_beside(image: Path) -> Path | None:
    """Return the map's YAML that lies beside its image, under the same name, and names it; None if there is none. Raises BadInputError."""
    for suffix in (".yaml", ".yml"):
        path = image.with_suffix(suffix)
        if path.is_file() and Path(str(_read_table(path).get("image"))).name == image.name:
            return path
    return None


def load_bend(yaml_path: Path) -> tuple[float, float]:
    """Return how far a map is bent, as its file says: standard deviations (m, rad); zeros where it says nothing. Raises BadInputError."""
    value = _read_table(yaml_path).get("bend", [0.0, 0.0])
    if not isinstance(value, list) or len(value) != 2:
        raise BadInputError(f"{yaml_path}: bend must be [metres, radians]")
    position, yaw = (_number(yaml_path, part, "bend") for part in value)
    if position < 0.0 or yaw < 0.0:
        raise BadInputError(f"{yaml_path}: bend must not be negative, found {value}")
    return position, yaw


def _as_saved(pixels: NDArray[np.uint8], description: _Description) -> NDArray[np.int8]:
    served = _as_served(pixels, description)
    if description.mode != "trinary" or description.is_negated:
        return served
    grey = pixels[:, :, 0] if pixels.shape[2] == 1 else _grey(pixels)
    saved = np.where(grey == PIXEL_UNKNOWN, np.int8(OCC_UNKNOWN), served)
    return saved if np.any(saved == OCC_FREE) else served  # a plan whose floor is painted with that grey


def _as_served(pixels: NDArray[np.uint8], description: _Description) -> NDArray[np.int8]:
    if (
        pixels.shape[2] == 1
    ):  # each grey once: those of a hall's pixels would be 32 MB of numbers, and several times that on the way
        return np.take(_served(_GREYS, description)[:, 0], pixels[:, :, 0])
    return _served(pixels, description)


def _served(pixels: NDArray[np.uint8], description: _Description) -> NDArray[np.int8]:
    grey = _grey(pixels)
    if description.mode == "raw":
        return np.where(grey <= 100, np.rint(grey), OCC_UNKNOWN).astype(np.int8)
    occupied = grey / 255.0 if description.is_negated else (255.0 - grey) / 255.0
    low, high = description.free_thresh, description.occupied_thresh
    out = np.full(grey.shape, OCC_UNKNOWN, np.int8)
    if description.mode == "scale":
        out[:] = np.clip(np.rint((occupied - low) / (high - low) * 100.0), 0, 100).astype(np.int8)
    out[occupied <= low] = OCC_FREE
    out[occupied >= high] = OCC_OCCUPIED
    if pixels.shape[2] in (2, 4):
        # a pixel of a trinary map that shows through in part is as dark as the map servers make it
        seen = 255 if description.mode == "scale" else 1
        out[pixels[:, :, -1] < seen] = OCC_UNKNOWN
    return out


def _grey(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    colours = pixels[:, :, : pixels.shape[2] - (pixels.shape[2] in (2, 4))]
    grey: NDArray[np.float64] = colours.mean(axis=2, dtype=np.float64)
    if pixels.shape[2] in (
        2,
        4,
    ):  # a see-through pixel shows nothing: as dark as the map servers make it, unknown by its alpha
        grey = grey * (pixels[:, :, -1] / 255.0)
    return grey


@dataclass(frozen=True, slots=True)
class _Description:
    image: Path
    resolution: float
    origin: tuple[float, float]
    yaw: float
    is_negated: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def _read_table(path: Path) -> dict[str, Any]:
    """Read a YAML file, or that of the map whose image is given."""
    if path.suffix.lower() in PICTURES and path.is_file():
        described = yaml_beside(path)
        if described is None:
            raise BadInputError(f"{path}: is a picture, and no YAML of its name lies beside it; give the map's YAML")
        path = described
    if path.is_dir():
        inside = ", ".join(file.name for file in sorted(path.glob("*.y*ml"))[:5])
        raise BadInputError(f"{path}: is a folder; give the map's YAML" + (f" (in it: {inside})" if inside else ""))
    try:
        table = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInputError(f"{path}: {' '.join(str(error).split())}") from error
    if not isinstance(table, dict):
        raise BadInputError(f"{path}: is no map description (a table with image, resolution, origin)")
    return table


def _read_description(path: Path) -> _Description:
    table = _read_table(path)
    missing = [key for key in ("image", "resolution", "origin") if key not in table]
    if missing:
        raise BadInputError(f"{path}: {missing[0]} is missing")
    mode = table.get("mode", "trinary")
    if mode not in MODES:
        raise BadInputError(f"{path}: mode {mode!r} is none of {', '.join(MODES)}")
    origin, yaw = _origin(path, table["origin"])
    high = _number(path, table.get("occupied_thresh", OCCUPIED_THRESH), "occupied_thresh")
    low = _number(path, table.get("free_thresh", FREE_THRESH), "free_thresh")
    if not 0.0 <= low < high <= 1.0:
        raise BadInputError(
            f"{path}: thresholds must be 0 <= free_thresh < occupied_thresh <= 1, found {low} and {high}"
        )
    resolution = _number(path, table["resolution"], "resolution")
    if resolution <= 0.0:
        raise BadInputError(f"{path}: resolution must be positive, found {resolution}")
    negate = table.get("negate", 0)
    if negate not in (0, 1):
        raise BadInputError(f"{path}: negate must be 0 or 1, found {negate!r}")
    image = path.parent / str(table["image"])
    return _Description(image, resolution, origin, yaw, bool(negate), high, low, mode)


def _number(path: Path, value: Any, key: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: {key} is no number: {value!r}") from error
    if not math.isfinite(number):
        raise BadInputError(f"{path}: {key} is not finite")
    return number


def _origin(path: Path, value: Any) -> tuple[tuple[float, float], float]:
    """Read where the outer corner of the lowest left pixel lies, and the yaw (rad) of the picture about it."""
    if not isinstance(value, list) or len(value) not in (2, 3):
        raise BadInputError(f"{path}: origin must be [x, y, yaw]")
    numbers = [_number(path, v, "origin") for v in value]
    yaw = math.remainder(numbers[2], 2.0 * math.pi) if len(numbers) == 3 else 0.0
    return (numbers[0], numbers[1]), yaw if abs(yaw) > 1e-6 else 0.0


def read_image(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[np.uint8]:
    """Return the pixels uint8 [row, column, channel], whatever the name ends with: P2, P5, P6 and everything OpenCV reads.

    `flags` are OpenCV's. Raises BadInputError.
    """
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror or error}") from error
    whitest = _check_netpbm(path, bytes(data[:4096]), len(data))
    try:
        image = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error as error:
        raise BadInputError(f"{path}: the image cannot be read") from error
    if image is None:
        raise BadInputError(f"{path}: is no image that can be read")
    if image.dtype not in (np.uint8, np.uint16):
        raise BadInputError(f"{path}: pixels of type {image.dtype} are not supported")
    if image.dtype == np.uint16 or whitest is not None:
        image = np.minimum(image.astype(np.uint32) * 255 // (whitest or 65535), 255).astype(np.uint8)
    pixels = np.asarray(image, np.uint8)
    return pixels[:, :, None] if pixels.ndim == 2 else pixels


def _check_netpbm(path: Path, head: bytes, size: int) -> int | None:
    """Refuse a binary netpbm file that is shorter than its header says; a decoder would fill the rest with anything. Returns the value of white that
    the decoder does not look at: it only scales texts of small ones."""
    is_binary = head[:2] in (b"P5", b"P6")
    if not is_binary and head[:2] not in (b"P2", b"P3"):
        return None
    words: list[bytes] = []
    position = 2
    while len(words) < 3:
        end = position + 1
        if position >= len(head):
            raise BadInputError(f"{path}: the header of the image is cut off")
        if head[position : position + 1] == b"#":
            end = head.find(b"\n", position) + 1 or len(head)
        elif not head[position : position + 1].isspace():
            while end < len(head) and not head[end : end + 1].isspace():
                end += 1
            words.append(head[position:end])
        position = end
    if not all(w.isdigit() and int(w) > 0 for w in words) or int(words[2]) > 65535:
        raise BadInputError(f"{path}: the header of the image is damaged")
    width, height, deepest = (int(w) for w in words)
    needed = position + 1 + width * height * (3 if head[:2] == b"P6" else 1) * (2 if deepest > 255 else 1)
    if is_binary and size < needed:
        raise BadInputError(f"{path}: the image is cut off after {size} of {needed} bytes")
    return deepest if is_binary or deepest > 255 else None
