"""Fields of results in words: units, sizes that are easy to read, and what matters first."""

import math

import pytest

from ambler.evaluation.metrics import METRICS, Group, metric_of, ordered, shown


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("coverage_ratio", 0.99123, "99.12 %"),
        ("dock_error_m", 0.0005888, "0.59 mm"),
        ("ate_rms_m", 0.01236, "1.2 cm"),
        ("path_length_m", 7.05, "7.05 m"),
        ("undock_x_m", -0.9503, "-95.0 cm"),
        ("nne_cells", 0.7584, "0.758 cells"),
        ("dock_error_deg", 1.5, "1.5 °"),
        ("sim_seconds", 22.07, "22.1 s"),
        ("peak_memory_mb", 822.8, "823 MB"),
        ("dock_code", "NO_DOCK_SEEN", "no dock seen"),
        ("is_home", True, "yes"),
        ("ssim", math.nan, "unknown"),
        ("goals", 3, "3"),
    ],
)
def test_values_have_units_and_a_size_that_is_easy_to_read(name: str, value: object, text: str) -> None:
    assert shown(name, value) == text


def test_what_matters_comes_first() -> None:
    names = ["peak_memory_mb", "recording", "own_field_m", "ssim", "coverage_ratio", "ate_rms_m", "collisions", "ended"]
    assert ordered(names) == [
        *("ended", "collisions", "ate_rms_m", "coverage_ratio", "ssim", "peak_memory_mb", "recording", "own_field_m")
    ]


def test_every_number_has_a_sentence_and_abbreviations_are_spelled_out() -> None:
    for name, metric in METRICS.items():
        if metric.group not in (Group.SETTING, Group.SMALL):
            assert metric.meaning.endswith("."), name
    assert "Nearest-neighbour error" in metric_of("nne_cells").meaning
    assert "Structural similarity" in metric_of("ssim").meaning
    assert "Absolute trajectory error" in metric_of("ate_rms_m").meaning
    assert metric_of("own_field_m").label == "own field"
