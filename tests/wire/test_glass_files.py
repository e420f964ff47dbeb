"""Glass beside a map: written and read back exactly; damaged files are refused by name."""

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.wire.glass_files import GlassFile, load_glass, save_glass


def test_glass_survives_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    glass = GlassFile("map", rng.normal(size=(5, 4)).astype(np.float32), rng.random(5).astype(np.float32), 12.5)
    path = save_glass(tmp_path / "office.v2", glass)
    assert path.name == "office.v2.glass.geojson"
    back = load_glass(path)
    assert (back.frame, back.seen_through_m2) == ("map", 12.5)
    np.testing.assert_array_equal(back.segments, glass.segments)
    np.testing.assert_array_equal(back.confidence, glass.confidence)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"features": []}',
        '{"frame": "map", "seen_through_m2": 0, "features": [{"properties": {"kind": "glass", "confidence": 2}, '
        '"geometry": {"coordinates": [[0, 0], [1, 1]]}}]}',
    ],
)
def test_a_damaged_file_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "map.glass.geojson"
    path.write_text(text)
    with pytest.raises(BadInputError, match=r"map\.glass\.geojson"):
        load_glass(path)
