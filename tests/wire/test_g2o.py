"""g2o files: round trip, ids in any order, clear errors."""

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.wire.g2o import read_g2o, write_g2o

GOOD = """# a comment
VERTEX_SE2 7 1 2 0.5
VERTEX_SE2 3 0 0 0

FIX 3
EDGE_SE2 3 7 1 2 0.5 10 1 2 20 3 30
"""


def test_reads_and_round_trips(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(GOOD)
    graph = read_g2o(path)
    assert graph.ids.tolist() == [3, 7]
    assert (graph.edge_from.tolist(), graph.edge_to.tolist(), graph.fixed) == ([0], [1], 0)
    np.testing.assert_array_equal(graph.information[0], [[10, 1, 2], [1, 20, 3], [2, 3, 30]])
    write_g2o(tmp_path / "b.g2o", graph)
    again = read_g2o(tmp_path / "b.g2o")
    np.testing.assert_array_equal(again.poses, graph.poses)
    np.testing.assert_array_equal(again.information, graph.information)
    np.testing.assert_array_equal(again.measurements, [[1.0, 2.0, 0.5]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("VERTEX_SE2 1 2 3\n", r":1: VERTEX_SE2 needs 4 numbers, found 3"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0\n", ":2: pose 0 is given twice"),
        ("VERTEX_SE2 0 0 0 zero\n", ":1: could not convert"),
        ("VERTEX_SE2 0 0 0 inf\n", ":1: a number is not finite"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 0 0 0 1 0 0 1 0 1\n", ":2: pose 1 does not exist"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", ":1: VERTEX_SE3:QUAT is no planar"),
        ("", "no VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0 0\nFIX 4\n", "fixed pose 4"),
        ("\xff\xfe", "codec"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.g2o"
    path.write_bytes(text.encode("latin1"))
    with pytest.raises(BadInputError, match=message):
        read_g2o(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"nowhere\.g2o"):
        read_g2o(tmp_path / "nowhere.g2o")
