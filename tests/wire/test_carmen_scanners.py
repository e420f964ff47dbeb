"""Old laser lines: the angles of every known scanner, what the parameters tell, and a word where both leave doubt."""

import math

import pytest

from ambler.core.errors import BadInputError
from ambler.wire.carmen_scanners import layout_of, mount_parameter, side_of, told_range


@pytest.mark.parametrize(
    ("beams", "first_deg", "step_deg"),
    [
        (180, -90.0, 1.0),
        (181, -90.0, 1.0),
        (360, -90.0, 0.5),
        (361, -90.0, 0.5),
        (400, -50.0, 0.25),
        (401, -50.0, 0.25),
        (540, -135.0, 0.5),
        (541, -135.0, 0.5),
        (1080, -135.0, 0.25),
        (1081, -135.0, 0.25),
        (682, -0.5 * 681 * 0.3515625, 0.3515625),
        (683, -0.5 * 682 * 0.3515625, 0.3515625),
        (769, -135.0, 0.3515625),
    ],
)
def test_known_scanners_are_told_by_their_number_of_beams(beams: int, first_deg: float, step_deg: float) -> None:
    layout = layout_of("FLASER", beams, {})
    assert math.degrees(layout.angle_min) == pytest.approx(first_deg)
    assert math.degrees(layout.angle_increment) == pytest.approx(step_deg)
    assert layout.doubt == ""


def test_an_unknown_number_of_beams_covers_a_half_turn_and_is_told() -> None:
    layout = layout_of("RLASER", 301, {"laser_front_laser_fov": "240"})
    assert math.degrees(layout.angle_min) == pytest.approx(-90.0)
    assert math.degrees(layout.angle_increment) == pytest.approx(0.6)
    assert layout.doubt.startswith("RLASER: 301 beams")
    assert "180 degrees" in layout.doubt


@pytest.mark.parametrize(
    "parameters",
    [
        {"laser_front_laser_fov": "240"},
        {"robot_front_laser_fov": "240"},
        {"robot_frontlaser_resolution": "0.8"},
        {"laser_front_laser_resolution": "0.8", "laser_front_laser_fov": "240"},
        {"laser_front_laser_resolution": "auto", "robot_frontlaser_fov": "240.0"},
    ],
)
def test_parameters_tell_the_angles_in_any_spelling(parameters: dict[str, str]) -> None:
    layout = layout_of("FLASER", 301, parameters)
    assert math.degrees(layout.angle_min) == pytest.approx(-120.0)
    assert math.degrees(layout.angle_increment) == pytest.approx(0.8)
    assert layout.doubt == ""


def test_parameters_win_over_the_usual_angles_and_that_is_told() -> None:
    layout = layout_of("FLASER", 361, {"laser_front_laser_resolution": "0.25"})
    assert math.degrees(layout.angle_min) == pytest.approx(-45.0)
    assert "90 degrees" in layout.doubt
    assert layout_of("FLASER", 361, {"laser_front_laser_resolution": "0.5"}) == layout_of("FLASER", 361, {})


def test_parameters_that_contradict_the_beams_or_each_other_are_left_out() -> None:
    assert layout_of("FLASER", 541, {"laser_front_laser_resolution": "1.0"}) == layout_of("FLASER", 541, {})
    both = layout_of("FLASER", 361, {"laser_front_laser_resolution": "1.0", "laser_front_laser_fov": "180"})
    assert math.degrees(both.angle_increment) == pytest.approx(0.5)
    assert "do not fit" in both.doubt


@pytest.mark.parametrize(
    ("name", "parameter", "reach"),
    [
        ("FLASER", "robot_front_laser_max", 8.1),
        ("FLASER", "robot_frontlaser_max", 8.1),
        ("FLASER", "laser_front_laser_maxrange", 8.1),
        ("RLASER", "robot_rear_laser_max", 8.1),
        ("RLASER", "robot_front_laser_max", math.inf),
        ("RAWLASER2", "robot_rear_laser_max", 8.1),
        ("ROBOTLASER3", "robot_front_laser_max", math.inf),
        ("FLASER", "vasco_laser_max_usable_range", math.inf),
    ],
)
def test_the_range_is_told_by_parameters(name: str, parameter: str, reach: float) -> None:
    assert told_range(name, {parameter: "8.1"}) == reach


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "on", "8191"])
def test_a_range_that_is_none_tells_nothing(value: str) -> None:
    assert told_range("FLASER", {"robot_front_laser_max": value}) == math.inf


def test_sides() -> None:
    names = ("FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2", "ROBOTLASER3", "RAWLASER1", "ROBOTLASER12")
    assert [side_of(name) for name in names] == ["front", "rear", "front", "rear", None, "front", None]


@pytest.mark.parametrize("text", ["off", "nan", "-inf", ""])
def test_an_offset_that_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="is no number"):
        mount_parameter("FLASER", {"robot_frontlaser_offset": text})
    assert mount_parameter("FLASER", {"robot_frontlaser_offset": "0.08"}) == 0.08
