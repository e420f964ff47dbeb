"""`ambler dock`, `ambler calibrate camera` and `ambler eval docking`: what they refuse, what they write, what they sum up."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.scene import RunOptions
from ambler.cli.main import main
from ambler.evaluation.docking import DetectionErrors, DockingOutcome, lower_bound, summarize, table
from ambler.evaluation.docking_pictures import draw_detections, draw_final_errors, draw_times
from ambler.nodes.steps import DockStep, TeachStep
from ambler.sim.camera import FRONT_CAMERA
from ambler.sim.world_file import load_world
from ambler.studies import docking_study
from ambler.wire.camera_info import load_camera_info

GOOD = DockingOutcome("random", 0, "SUCCEEDED", "", 1, 9.0, 10.0, 7.0, 0.0003, -0.0004, 0.01, 0)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["dock", "bay_7"], "no dock 'bay_7'"),
        (["dock", "charger_1", "--world", "two_rooms"], "no docks"),
        (["dock", "charger_1", "--start", "0,0,north"], "x,y,degrees"),
        (["dock", "charger_1", "--docks", "nowhere.yaml"], "nowhere.yaml"),
        (["dock", "charger_1", "--teach"], "--docks"),
        (["dock", "charger_1", "--fault", "darkness"], "darkness"),
        (["dock", "charger_1", "--camera", "none.yaml"], "none.yaml"),
        (["undock", "bay_7"], "no dock 'bay_7'"),
        (["calibrate", "camera", "--out", "c.yaml"], "pictures"),
        (["calibrate", "camera", "missing.png", "--out", "c.yaml"], "missing.png"),
        (["calibrate", "camera", "--simulated", "--board", "7by5", "--out", "c.yaml"], "7by5"),
        (["eval", "docking", "--runs", "0"], "at least 1"),
        (["eval", "docking", "--looks", "0"], "positive"),
        (["eval", "docking", "--world", "dock_shapes", "--dock", "bay"], "no dock 'bay'"),
        (["eval", "docking", "--world", "dock_shapes", "--dock", "charger_v", "--only", "faults"], "sights, random"),
        (["eval", "docking", "--world", "dock_room", "--only", "sights"], "--only random"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ambler.kernels.warmup.warm_up", lambda names: None)
    assert main(arguments) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert word in told[0]


def test_what_is_taught_into_a_file_that_is_not_there_begins_with_the_plan(tmp_path: Path) -> None:
    teaching = RunOptions(steps=(TeachStep("charger_1"),), world="dock_room", docks_file=tmp_path / "docks.yaml")
    assert teaching.known_docks_file is None
    assert replace(teaching, steps=(DockStep("charger_1"),)).known_docks_file == tmp_path / "docks.yaml"
    (tmp_path / "docks.yaml").write_text("docks: {}")
    assert teaching.known_docks_file == tmp_path / "docks.yaml"


def test_a_camera_is_calibrated_from_simulated_boards(tmp_path: Path) -> None:
    out, result = tmp_path / "camera.yaml", tmp_path / "result.json"
    assert main(["calibrate", "camera", "--simulated", "--out", str(out), "--json", str(result)]) == 0
    fields = json.loads(result.read_text())
    assert fields["focal_error_px"] < 1.0
    assert fields["error_rms_px"] < 0.2
    camera = load_camera_info(out)
    assert abs(camera.fx - FRONT_CAMERA.fx) < 1.0
    corner = np.array([[-0.5, -0.4]])
    assert np.abs(camera.distort(corner) - FRONT_CAMERA.distort(corner)).max() < 1.0


def test_a_summary_counts_what_happened() -> None:
    late = replace(GOOD, seed=1, attempts=3, error_x=0.006, error_y=0.0)
    lost = replace(
        GOOD, seed=2, code="DOCK_LOST", attempts=3, error_x=None, error_y=None, error_yaw_deg=None, docking_seconds=None
    )
    far = replace(GOOD, kind="approach", distance=25.0, approach_seconds=26.0, docking_seconds=8.0)
    dark = replace(GOOD, kind="no_power", code="NO_CHARGE", collisions=1)
    fields = summarize([GOOD, late, lost, far, dark])
    assert fields["runs"] == 3
    assert math.isclose(fields["success_ratio"], 2 / 3)
    assert fields["within_two_attempts"] == 1
    assert fields["first_attempt"] == 1
    assert math.isclose(fields["position_error_max_m"], 0.006)
    assert math.isclose(fields["position_error_median_m"], 0.5 * (0.006 + 0.0005))
    assert math.isclose(fields["attempts_mean"], 7 / 3)
    assert fields["approach_25m_s"] == 26.0
    assert "approach_9m_s" not in fields
    assert math.isclose(fields["approach_position_error_max_m"], 0.0005)
    assert fields["docking_time_median_s"] == 7.0
    assert fields["fault_no_power_failures"] == "NO_CHARGE"
    assert fields["fault_no_power_docked"] == 0
    assert fields["collisions"] == 1
    text = table(fields)
    assert "| approach, 25 m | 55 s | 26.0 s |" in text
    assert "9 m" not in text


def test_untaught_and_taught_are_told_apart() -> None:
    taught = replace(GOOD, kind="taught", error_x=0.001, error_yaw_deg=-0.2)
    untaught = replace(GOOD, error_x=0.007, error_yaw_deg=0.4, attempts=2)
    fields = summarize([untaught, taught, replace(taught, code="NOT_TAUGHT", attempts=0)])
    assert fields["runs"] == 1
    assert fields["yaw_error_max_deg"] == 0.4
    assert fields["taught_runs"] == 2
    assert fields["taught_within_two_attempts"] == 1
    assert math.isclose(fields["taught_yaw_error_max_deg"], 0.2)
    assert math.isclose(fields["taught_position_error_p95_m"], math.hypot(0.001, 0.0004))
    assert not docking_study.is_good(replace(taught, code="NOT_TAUGHT", attempts=0))


def test_every_random_start_is_tried_untaught_and_taught_with_the_same_drawn_flaws() -> None:
    cases = docking_study.imperfect([*docking_study.random_cases(3, 11), *docking_study.fault_cases(1, 4)])
    assert [c.kind for c in cases[:6]] == ["random", "taught"] * 3
    assert [c.is_taught for c in cases[:6]] == [False, True] * 3
    assert all(a.start == b.start and a.seed == b.seed for a, b in zip(cases[:6:2], cases[1:6:2], strict=True))
    assert all(c.imperfections == docking_study.DRAWN for c in cases)
    assert all(c.is_taught for c in cases[6:])
    assert len({c.label for c in cases}) == len(cases)


def test_the_interval_of_a_ratio_is_exact() -> None:
    assert math.isclose(lower_bound(60, 60), 0.025 ** (1 / 60), rel_tol=1e-9)
    assert lower_bound(0, 10) == 0.0
    assert lower_bound(9, 10) < 0.9


def test_sights_are_summed_up_by_axis() -> None:
    errors = np.stack((np.linspace(-1.0, 1.0, 201), np.full(201, 0.5), np.zeros(201)), axis=1)
    fields = DetectionErrors("marker_still", errors).summary()
    assert math.isclose(fields["marker_still_p95_x_mm"], 0.95, abs_tol=0.01)
    assert fields["marker_still_max_y_mm"] == 0.5
    assert fields["marker_still_std_y_mm"] == 0.0


def test_pictures_are_drawn(tmp_path: Path) -> None:
    outcomes = [replace(GOOD, seed=k, error_x=1e-4 * k) for k in range(5)]
    draw_final_errors(tmp_path / "a.png", outcomes)
    draw_times(tmp_path / "b.png", outcomes)
    draw_detections(
        tmp_path / "c.png", [DetectionErrors("marker_still", np.random.default_rng(0).normal(size=(30, 3)))]
    )
    assert all((tmp_path / f"{n}.png").stat().st_size > 5000 for n in "abc")


def test_starts_are_random_and_the_same_for_the_same_seed() -> None:
    cases = docking_study.random_cases(20, 5)
    assert cases == docking_study.random_cases(20, 5)
    assert cases[0].start != docking_study.random_cases(20, 6)[0].start
    assert max(c.distance for c in cases) > 15.0
    world = load_world(docking_study.WORLD)
    for case in [*cases, *docking_study.approach_cases(0), *docking_study.fault_cases(1, 0)]:
        place = world.docks[0].world_from_dock @ case.start
        for solid in world.solids:
            if solid.z_min < 0.35:
                inside = solid.world_from_solid.inverse() @ place
                assert abs(inside.x) > 0.5 * solid.size_x + 0.4 or abs(inside.y) > 0.5 * solid.size_y + 0.4


def test_an_outcome_is_the_same_when_it_was_kept() -> None:
    kept = {**json.loads(json.dumps(GOOD.to_dict())), "label": "random-0", "world": "dock_hall"}
    assert docking_study.outcome_of(kept) == GOOD
    assert docking_study.docking_line(kept) == "SUCCEEDED in 1 0.50 mm +0.010° approach 10.0 s docking 7.0 s"
    assert docking_study.is_good(GOOD)
    assert not docking_study.is_good(replace(GOOD, attempts=3))
    assert not docking_study.is_good(replace(GOOD, collisions=1))
    assert docking_study.is_good(replace(GOOD, kind="no_power", code="NO_CHARGE", attempts=3))
    assert not docking_study.is_good(replace(GOOD, kind="no_power", code="CRASHED"))
