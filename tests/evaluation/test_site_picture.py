"""The picture of a site: every level is drawn, and the way on the level that carries it."""

from __future__ import annotations

import numpy as np

from ambler.core.grid import GridSpec
from ambler.evaluation import site_picture


def test_the_way_belongs_to_the_level_whose_ground_carries_it() -> None:
    spec = GridSpec(0.1, 50, 50, 0.0, 0.0)
    way = np.array([[1.0, 1.0, 0.05], [2.0, 2.0, 3.1], [9.0, 9.0, 0.0]])
    low, high = np.zeros(spec.shape, np.float32), np.full(spec.shape, 3.0, np.float32)
    assert site_picture._carries(spec, low, way).tolist() == [True, False, False]
    assert site_picture._carries(spec, high, way).tolist() == [False, True, False]


def test_a_level_of_which_nothing_is_known_is_drawn_too(tmp_path) -> None:  # type: ignore[no-untyped-def]
    spec = GridSpec(0.1, 50, 50, 0.0, 0.0)
    known = (spec, np.zeros(spec.shape, np.int8), np.zeros(spec.shape, np.float32))
    nothing = (spec, np.full(spec.shape, -1, np.int8), np.full(spec.shape, np.nan, np.float32))
    path = site_picture.draw_site(tmp_path / "site.png", [known, nothing], np.zeros((0, 3)), np.zeros((0, 5)))
    assert path.stat().st_size > 5000
