"""The glass of a map as a file beside it: GeoJSON lines in the map's metres, so that every map editor can draw them.

`<stem>.glass.geojson` holds a FeatureCollection of LineStrings with `kind: glass` and a `confidence`, the frame, and the area that the
map shows only because it was seen through glass. It has no coordinates on the Earth: `coordinates` are x, y of the map frame.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole

SUFFIX = ".glass.geojson"


@dataclass(frozen=True, eq=False)
class GlassFile:
    """Segments float32 (N, 4) of (x0, y0, x1, y1) with confidence float32 (N,) in `frame`, and the area known only through them, m²."""

    frame: str
    segments: NDArray[np.float32]
    confidence: NDArray[np.float32]
    seen_through_m2: float


def save_glass(stem: Path, glass: GlassFile) -> Path:
    """Write `<stem>.glass.geojson`; it appears at once or not at all. Returns its path."""
    features = [
        {
            "type": "Feature",
            "properties": {"kind": "glass", "confidence": float(c)},
            "geometry": {"type": "LineString", "coordinates": [[float(s[0]), float(s[1])], [float(s[2]), float(s[3])]]},
        }
        for s, c in zip(glass.segments, glass.confidence, strict=True)
    ]
    content = {
        "type": "FeatureCollection",
        "frame": glass.frame,
        "seen_through_m2": glass.seen_through_m2,
        "features": features,
    }
    path = stem.with_name(stem.name + SUFFIX)
    write_whole(path, json.dumps(content, indent=1) + "\n")
    return path


def load_glass(path: Path) -> GlassFile:
    """Read a file of glass; raises BadInputError that names the file and what is wrong."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        features = [f for f in content["features"] if f["properties"].get("kind") == "glass"]
        ends = [f["geometry"]["coordinates"] for f in features]
        segments = np.array([[*a, *b] for a, b in ends], np.float32).reshape(-1, 4)
        confidence = np.array([f["properties"]["confidence"] for f in features], np.float32)
        glass = GlassFile(str(content["frame"]), segments, confidence, float(content["seen_through_m2"]))
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{path} is no file of glass: {error!r}") from error
    if not (np.isfinite(segments).all() and ((confidence >= 0.0) & (confidence <= 1.0)).all()):
        raise BadInputError(f"{path}: segments must be finite and confidences between 0 and 1")
    return glass
