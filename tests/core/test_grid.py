"""Only GridSpec converts between metres and cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ambler.core.grid import GridSpec
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits

specs = st.builds(
    GridSpec,
    st.sampled_from([0.025, 0.05, 0.1]),
    st.integers(1, 500),
    st.integers(1, 500),
    st.floats(-20, 20),
    st.floats(-20, 20),
)


@given(specs, st.integers(0, 499), st.integers(0, 499))
def test_a_cells_centre_lies_in_it(spec: GridSpec, iy: int, ix: int) -> None:
    assert spec.cell_of(*spec.center_of(iy, ix)) == (iy, ix)
    assert spec.contains_cell(iy, ix) == (iy < spec.height and ix < spec.width)


@given(specs, st.lists(st.tuples(st.integers(-50, 600), st.integers(-50, 600)), min_size=1, max_size=9))
def test_arrays_agree_with_single_cells(spec: GridSpec, cells: list[tuple[int, int]]) -> None:
    centers = spec.centers_of(np.array(cells))
    assert [tuple(c) for c in centers] == [spec.center_of(*c) for c in cells]
    assert np.array_equal(spec.cells_of(centers), np.array(cells))


def test_radii_of_a_rectangle() -> None:
    corners = np.array([[0.55, 0.25], [-0.55, 0.25], [-0.55, -0.25], [0.55, -0.25]])
    robot = RobotModel("box", DriveKind.OMNI, corners, VelocityLimits())
    assert np.isclose(robot.inscribed_radius, 0.25)
    assert np.isclose(robot.circumscribed_radius, np.hypot(0.55, 0.25))
