"""TUM trajectories: round trip to the digits of the format, spatial poses, clear errors."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ambler.core.errors import BadInputError
from ambler.wire.trajectory_files import read_tum_3d
from ambler.wire.tum import read_tum, write_tum


@given(poses=arrays(np.float64, (5, 3), elements=st.floats(-3.0, 3.0)))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, poses: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("tum") / "t.tum"
    stamps = 976052857.271842 + 0.1 * np.arange(5)
    write_tum(path, stamps, poses)
    again_stamps, again = read_tum(path)
    np.testing.assert_allclose(again_stamps, stamps, atol=1e-6)
    np.testing.assert_allclose(again, poses, atol=1e-6)
    assert [p.name for p in path.parent.iterdir()] == ["t.tum"]


def test_first_line_is_as_specified(tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", np.array([1.5]), np.array([[1.0, -2.0, np.pi]]))
    words = (tmp_path / "t.tum").read_text().split()
    assert words[:4] == ["1.500000", "1.000000", "-2.000000", "0.000000"]
    assert [float(w) for w in words[4:]] == pytest.approx([0.0, 0.0, 1.0, 0.0], abs=1e-9)


def test_spatial_poses_are_projected(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("# stamp x y z qx qy qz qw\n2 1 2 3 0 0 2 2\n\n")
    _, poses = read_tum(path)
    np.testing.assert_allclose(poses, [[1.0, 2.0, np.pi / 2]])


@pytest.mark.parametrize(
    ("text", "message"),
    [("1 2 3\n", ":1: a pose has 8"), ("#\n1 2 3 4 5 6 7 x\n", ":2: could not"), ("1 0 0 0 0 0 0 0\n", ":1: .*zero")],
)
def test_errors_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(BadInputError, match=message):
        read_tum(tmp_path / "t.tum")


@pytest.mark.parametrize("stamp", ["1700000001099979997", "1700000001099979", "1700000001099.98", "1.7e18", "-1e300"])
def test_stamps_that_are_no_seconds_are_named(tmp_path: Path, stamp: str) -> None:
    """In ns they had ended in an overflow, in ms every pose was thousands of years away."""
    (tmp_path / "t.tum").write_text(f"# stamp\n{stamp} 0 0 0 0 0 0 1\n")
    for read in (read_tum, read_tum_3d):
        with pytest.raises(BadInputError, match=rf"t.tum:2: the stamp {re.escape(stamp)} is no time in seconds"):
            read(tmp_path / "t.tum")


def test_poses_in_space_come_in_the_order_of_time(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_text("".join(f"{t} {t} 0 0 0 0 0 1\n" for t in (3, 1.5, 2, 1)))
    stamps_ns, poses = read_tum_3d(tmp_path / "t.tum")
    assert stamps_ns.tolist() == [1_000_000_000, 1_500_000_000, 2_000_000_000, 3_000_000_000]
    assert [pose.translation[0] for pose in poses] == [1.0, 1.5, 2.0, 3.0]
