"""Errors against relations: hand-made motions, damaged files, and the odometry of the recorded logs."""

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.relations import Relation, load_relations, relation_errors
from ambler.wire.carmen import load_carmen
from tests.public_data import public


def test_errors_are_those_of_the_relative_motion() -> None:
    poses = np.array([[1.0, 2.0, 0.5], [2.0, 2.5, 1.0], [0.0, 0.0, -3.0]])
    exact = SE2.from_array(poses[0]).inverse() @ SE2.from_array(poses[1])
    relations = [
        Relation(1_000_000, 2_500_000, exact @ SE2(0.03, 0.04, 0.1)),
        Relation(1_000_000, 9_000_000, SE2()),
    ]
    errors = relation_errors(relations, [1.0, 2.5, 3.0], poses)
    assert errors.translation.tolist() == pytest.approx([0.05])
    assert errors.rotation.tolist() == pytest.approx([0.1])
    assert errors.fields()["relations_used"] == 1
    with pytest.raises(BadInputError, match="none of the 1"):
        relation_errors(relations[1:], [1.0], poses[:1])


def test_turns_to_both_sides_do_not_cancel() -> None:
    """A trajectory that is off by 0.2 rad to the left and to the right in turn is not right in the mean."""
    poses = np.zeros((3, 3))
    relations = [Relation(0, k * 1_000_000, SE2(0.0, 0.0, yaw)) for k, yaw in ((1, 0.2), (2, -0.2))]
    errors = relation_errors(relations, [0.0, 1.0, 2.0], poses)
    assert errors.rotation.tolist() == pytest.approx([0.2, 0.2])
    assert errors.fields()["rotation_mean_deg"] == pytest.approx(np.degrees(0.2))


@pytest.mark.parametrize("text", ["1 2 3\n", "1 2 0 0 0 0 0 x\n", "1 2 nan 0 0 0 0 0\n", "", "\x80"])
def test_damaged_relations_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "some.relations"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInputError):
        load_relations(path)


@pytest.mark.parametrize(
    ("name", "count", "mean", "std", "degrees"),
    [("intel", 2984, 7.370, 14.35, 39.2), ("fr079", 1685, 6.504, 13.66, 30.3)],
)
def test_odometry_alone_gives_the_known_errors(name: str, count: int, mean: float, std: float, degrees: float) -> None:
    log = load_carmen(public(f"radish/{name}.clf.bz2"))
    poses = np.array([line.odom_from_base.as_array() for line in log.lasers])
    errors = relation_errors(load_relations(public(f"radish/{name}.relations")), [x.stamp for x in log.lasers], poses)
    fields = errors.fields()
    assert fields["relations_used"] == count
    assert fields["translation_mean_m"] == pytest.approx(mean, abs=0.001)
    assert fields["translation_std_m"] == pytest.approx(std, abs=0.01)
    assert fields["rotation_mean_deg"] == pytest.approx(degrees, abs=0.05)
