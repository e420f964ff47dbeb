"""The study of LiDAR-inertial odometry on a short case, its bars, and its summary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.lio.degeneracy import Degeneracy
from ambler.lio.health import Health, LioResult
from ambler.lio.loop_match import Closure
from ambler.studies.lio_study import LioCase, check, is_false_closure, nees, run_case, summarize


def test_a_short_hall_meets_its_bar(tmp_path: Path) -> None:
    result = run_case(LioCase("hall", 5, "vlp_16", 30.0), tmp_path)
    assert result["is_met"]
    assert result["start_rms_pct"] < 0.1
    assert result["surface_rms_m"] < 0.03
    assert result["stray_ratio"] < 0.1
    assert result["lost"] == 0
    assert result["false_closures"] == 0
    assert result["closed_rms_m"] < 0.03
    assert result["closed_surface_rms_m"] < 0.03
    fields = summarize([{**result, "kind": "hall", "lidar": "vlp_16", "label": "hall-5"}])
    assert fields["runs_met"] == 1
    assert fields["hall-5.start_rms_m"] == result["start_rms_m"]


def test_unknown_names_are_refused() -> None:
    check(["site"], ["os_64"])
    for kinds, lidars in ((["moon"], []), ([], ["radar"])):
        with pytest.raises(BadInputError, match="one of"):
            check(kinds, lidars)


def test_a_closure_is_false_beside_the_truth_but_not_along_what_it_leaves_free() -> None:
    true, free = np.eye(4), np.array([[1.0, 0.0, 0.0]])
    for shift, weak, is_false in (
        ((0.5, 0.0, 0.0), np.zeros((0, 3)), True),
        ((0.2, 0.1, 0.0), np.zeros((0, 3)), False),
        ((5.0, 0.0, 0.0), free, False),
        ((5.0, 0.4, 0.0), free, True),
    ):
        told = SE3(shift).matrix()
        closure = Closure(0, 1, told, np.eye(6), np.eye(6), 0.9, 0.01, 0.0, weak)
        assert is_false_closure(closure, true) == is_false
    turned = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, 0.06).matrix()
    assert is_false_closure(Closure(0, 1, turned, np.eye(6), np.eye(6), 0.9, 0.01, 0.0, free), true)


def test_the_bar_of_loop_closure_is_of_all_sites_together() -> None:
    def run(rms: float, most: float, false: int = 0) -> dict[str, object]:
        return {"kind": "site", "lidar": "vlp_16", "label": f"{rms}", "closed_rms_m": rms, "closed_max_m": most, "closures": 2, "false_closures": false, "is_met": True}  # fmt: skip

    good = [run(0.05, 0.1), run(0.09, 0.2), run(0.2, 0.29)]
    assert summarize(good)["is_closing_met"]
    assert summarize(good)["is_met"]
    for bad in (run(0.11, 0.31), run(0.01, 0.02, 1)):
        assert not summarize([*good, bad])["is_closing_met"]
        assert not summarize([*good, bad])["is_met"]


def test_errors_as_large_as_the_covariance_says_give_one() -> None:
    rng = np.random.default_rng(0)
    sigma = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    health = Health(1, 1, 0.0, 0.0, 0.0, 0.3, *([Degeneracy.none().translation] * 2), 1, 0.0, False)
    results, truth = [], []
    for k in range(2000):
        e = sigma * rng.standard_normal(6) if k else np.zeros(6)
        x, y, z = e[:3].tolist()
        turn = SE3.from_rpy((0.0, 0.0, 0.0), *(float(v) for v in e[3:]))
        results.append(LioResult(k, SE3(), np.zeros(3), np.diag(sigma**2), np.zeros((0, 3)), health))
        truth.append(SE3((x, y, z)) @ turn)
    assert nees(results, truth) == pytest.approx(1.0, abs=0.06)
