"""Levels of ground in files: back as they were, and one clear error for anything else."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.wire.ground_files import load_levels, load_passages, save_levels


def levels():
    rng = np.random.default_rng(0)
    out = []
    for k in range(2):
        spec = GridSpec(0.1, 7 + k, 5, -1.0 - k, 2.0)
        heights = rng.normal(size=spec.shape).astype(np.float32)
        heights[0, 0] = np.nan
        out.append((spec, rng.choice([-1, 0, 100], spec.shape).astype(np.int8), heights))
    return out


def test_levels_come_back(tmp_path):
    path = save_levels(tmp_path / "map", levels())
    for (spec, occupancy, heights), (told_spec, told, told_heights) in zip(levels(), load_levels(path), strict=True):
        assert told_spec == spec
        np.testing.assert_array_equal(told, occupancy)
        np.testing.assert_array_equal(told_heights, heights)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_torn_file_is_refused(tmp_path, share):
    path = save_levels(tmp_path / "map", levels())
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BadInputError, match="levels"):
        load_levels(path)


def test_what_is_no_level_is_refused(tmp_path):
    path = tmp_path / "x.levels.npz"
    np.savez(path, other=np.zeros(3))
    with pytest.raises(BadInputError, match="no level"):
        load_levels(path)
    np.savez(path, spec_0=np.array([0.1, 4, 4, 0, 0]), occupancy_0=np.zeros((3, 4)), heights_0=np.zeros((4, 4)))
    with pytest.raises(BadInputError, match="geometry"):
        load_levels(path)
    with pytest.raises(BadInputError):
        load_levels(tmp_path / "missing.npz")


def test_passages_come_back_and_files_of_before_have_none(tmp_path):
    passages = np.array([[0.0, 1.0, 3.5, -2.0, 0.5], [1.0, 0.0, 3.5, -2.0, 0.5]])
    np.testing.assert_array_equal(load_passages(save_levels(tmp_path / "map", levels(), passages)), passages)
    assert load_passages(save_levels(tmp_path / "flat", levels())).shape == (0, 5)
    (spec, occupancy, heights), *_ = levels()
    numbers = np.array([spec.resolution, spec.width, spec.height, spec.origin_x, spec.origin_y])
    np.savez(tmp_path / "old.npz", spec_0=numbers, occupancy_0=occupancy, heights_0=heights)
    assert load_passages(tmp_path / "old.npz").shape == (0, 5)
    np.savez(tmp_path / "bad.npz", passages=np.full((1, 5), np.nan))
    with pytest.raises(BadInputError, match="passages"):
        load_passages(tmp_path / "bad.npz")
