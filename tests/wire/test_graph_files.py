"""Files of visibility graphs: round trips, and one clear error for whatever was cut or changed."""

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.wire.graph_files import MAGIC, load_graph, save_graph

ARRAYS = {
    "nodes": np.arange(12.0).reshape(3, 4),
    "alive": np.array([True, False, True]),
    "none": np.zeros((0, 2), np.int8),
}


def test_arrays_come_back_as_they_were_and_equal_graphs_make_equal_files(tmp_path: Path) -> None:
    path, other = tmp_path / "a.vgraph", tmp_path / "b.vgraph"
    save_graph(path, ARRAYS)
    save_graph(other, dict(reversed(ARRAYS.items())))
    assert path.read_bytes() == other.read_bytes()
    loaded = load_graph(path)
    assert set(loaded) == set(ARRAYS)
    for name, array in ARRAYS.items():
        assert loaded[name].dtype == array.dtype
        np.testing.assert_array_equal(loaded[name], array)


@pytest.mark.parametrize("left", [0, 5, len(MAGIC), len(MAGIC) + 10, len(MAGIC) + 40, -30, -1])
def test_a_file_that_was_cut_is_refused(tmp_path: Path, left: int) -> None:
    path = tmp_path / "a.vgraph"
    save_graph(path, ARRAYS)
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(BadInputError, match=r"a\.vgraph"):
        load_graph(path)


def test_a_file_with_a_wrong_bit_and_one_that_is_not_there_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.vgraph"
    save_graph(path, ARRAYS)
    raw = bytearray(path.read_bytes())
    raw[-40] ^= 1
    path.write_bytes(bytes(raw))
    with pytest.raises(BadInputError, match="damaged"):
        load_graph(path)
    with pytest.raises(BadInputError, match="cannot be read"):
        load_graph(tmp_path / "none.vgraph")
