"""Inflation against SciPy's exact distance transform, whole and by boxes; the cost table."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from ambler.core.errors import BadInputError
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.costmap.inflation import Inflation, InflationConfig, cost_table

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits())


def random_source(rng: np.random.Generator) -> np.ndarray:
    shape = tuple(rng.integers(1, 60, 2))
    return rng.choice(np.array([0, 90, 253, 254, 255], np.uint8), shape, p=[0.77, 0.05, 0.05, 0.03, 0.1])


def slow_twin(source: np.ndarray, inflation: Inflation) -> np.ndarray:
    """Inflate with SciPy's distances and the rules of costmap_2d."""
    if not (source == 254).any():
        return source.copy()
    squared = np.rint(distance_transform_edt(source != 254) ** 2).astype(int)
    new = inflation.table[np.minimum(squared, len(inflation.table) - 1)]
    return np.where(source == 255, np.where(new >= 253, new, 255), np.maximum(source, new))


@given(seed=st.integers(0, 10**6), radius=st.floats(0.0, 0.9))
@settings(max_examples=150, deadline=None)
def test_costs_equal_those_of_the_exact_distance(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    source = random_source(rng)
    inflation = Inflation(InflationConfig(radius=radius, scaling=4.0), ROBOT, 0.05)
    out = np.empty_like(source)
    inflation.inflate(source, out)
    np.testing.assert_array_equal(out, slow_twin(source, inflation))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=100, deadline=None)
def test_inflating_a_changed_box_equals_inflating_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = random_source(rng)
    inflation = Inflation(InflationConfig(radius=0.3), ROBOT, 0.05)
    costs = np.empty_like(source)
    inflation.inflate(source, costs)
    y0, x0 = (int(rng.integers(0, n)) for n in source.shape)
    y1, x1 = int(rng.integers(y0, source.shape[0])) + 1, int(rng.integers(x0, source.shape[1])) + 1
    changed = source.copy()
    changed[y0:y1, x0:x1] = rng.choice(np.array([0, 254, 255], np.uint8), (y1 - y0, x1 - x0))
    inflation.inflate(changed, costs, (y0, y1, x0, x1))
    np.testing.assert_array_equal(costs, slow_twin(changed, inflation))


def test_the_table_is_costmap_2ds() -> None:
    table = cost_table(11, 0.05, 0.25, 10.0)
    assert table[0] == 254
    assert table[25] == 253  # 5 cells = 0.25 m, the inscribed radius
    assert table[36] == int(252 * np.exp(-10.0 * 0.05))
    assert table[121] == int(252 * np.exp(-10.0 * 0.30))
    assert table[122] == 0
    assert (np.diff(table.astype(int)) <= 0).all()


def test_the_automatic_radius_comes_from_the_footprint() -> None:
    inflation = Inflation(InflationConfig(), ROBOT, 0.05)
    assert inflation.inscribed_radius == pytest.approx(0.22)
    assert inflation.radius == pytest.approx(np.hypot(0.3, 0.22) + 0.5)
    tiny = Inflation(InflationConfig(radius=0.01), ROBOT, 0.05)
    source = np.zeros((9, 9), np.uint8)
    source[4, 4] = 254
    out = np.empty_like(source)
    tiny.inflate(source, out)
    np.testing.assert_array_equal(out, source)
    with pytest.raises(BadInputError):
        Inflation(InflationConfig(radius=-1.0), ROBOT, 0.05)
