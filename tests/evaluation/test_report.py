"""The report holds everything it was given, in one file that needs no other; the command line writes it."""

import argparse
import base64
import json
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.cli import eval_map
from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, FrontierState
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.map_quality import compare_maps
from ambler.evaluation.pictures import Mark, darkest, draw_map_with_trajectory, draw_overlay, draw_series
from ambler.evaluation.report import Picture, Table, collision_table, frontier_table, write_report
from ambler.wire.map_files import save_map
from tests.evaluation.plans import office


def some_frontiers() -> tuple[Frontier, ...]:
    cells = np.array([[1.0, 2.0], [1.05, 2.0]], np.float32)
    return (
        Frontier(cells, (1.02, 2.0), None, math.inf, FrontierState.UNREACHABLE, "behind <glass>"),
        Frontier(cells + 1, (2.02, 3.0), None, math.inf, FrontierState.TOO_SMALL, "0.10 m long, less than 0.50 m"),
    )


def test_the_page_is_self_contained_and_complete(tmp_path: Path) -> None:
    spec, grid = office()
    path = np.column_stack([np.linspace(0, 5, 50), np.full(50, 4.5), np.zeros(50)])
    pictures = [
        Picture(
            "map", draw_map_with_trajectory(tmp_path / "map.png", spec, grid, {"estimated": path}, some_frontiers())
        ),
        Picture("overlay", draw_overlay(compare_maps((spec, grid), (spec, grid)), tmp_path / "overlay.png")),
        Picture("coverage", draw_series(tmp_path / "c.png", "time (s)", "coverage", {"a": ([0, 1], [0, 1])})),
    ]
    results = {"coverage_ratio": 0.9912, "ate_rms_m": math.nan, "collisions": 0, "is_home": True, "ssim": None}
    tables = [frontier_table(some_frontiers()), collision_table(find_collisions([]))]
    page = write_report(
        tmp_path, "A <run>", results, pictures, tables, configuration="x: 1", passed={"collisions": True}
    )
    text = page.read_text()
    assert "A &lt;run&gt;" in text
    assert "behind &lt;glass&gt;" in text
    assert "no collision" in text
    assert "no other frontier" not in text
    assert "1 more are dust" in text
    assert "0.10 m long" not in text
    assert "99.12 %" in text
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    embedded = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert [base64.b64decode(e) for e in embedded] == [p.path.read_bytes() for p in pictures]
    record = json.loads((tmp_path / "report.json").read_text())
    assert record["results"] == {**results, "ate_rms_m": None}
    assert [row["reason"] for row in record["tables"]["Frontiers that remain"]] == ["behind <glass>"]


def test_what_matters_comes_first_and_paths_stand_in_the_small_print(tmp_path: Path) -> None:
    results = {
        **{"world": "hall", "ended": "time_limit", "text": "the time limit of 5 s is over", "nne_cells": 0.7},
        **{"collisions": 2, "ssim": None, "ate_rms_m": 0.02, "recording": "/runs/x/recording", "sim_seconds": 5.0},
    }
    passed = {"ended": False, "collisions": False}
    text = write_report(tmp_path, "t", results, passed=passed).read_text()
    wanted = [
        *("time limit</b>the time limit of 5 s is over; 2 collisions", "Collisions</span>", "Trajectory error (ATE)"),
        *("Walls missed (NNE)", "Time of the run", "World: hall", "Recording: /runs/x/recording"),
        "Not known of this run: Likeness of the maps (SSIM)",
    ]
    places = [text.index(word) for word in wanted]
    assert places == sorted(places)
    cards = re.findall(r'<div class="card.*?</div>', text)
    assert len(cards) == 4
    assert all("<small>" in card for card in cards), "each number has its sentence"
    assert not any("/runs/x" in card for card in cards)
    assert '<div class="verdict bad">' in text


def test_walls_stay_visible_under_dust(tmp_path: Path) -> None:
    """Dots of dust along racks of one cell buried them."""
    spec, grid = office()
    cells = spec.centers_of(np.argwhere(grid >= 65)).astype(np.float32)
    dust = Frontier(cells, (1.0, 1.0), None, math.inf, FrontierState.TOO_SMALL, "0.05 m long")

    def walls(frontiers: tuple[Frontier, ...]) -> int:
        picture = cv2.imread(str(draw_map_with_trajectory(tmp_path / "m.png", spec, grid, {}, frontiers)))
        return int((picture[int(0.1 * len(picture)) :].max(axis=2) < 70).sum())

    assert walls((dust,)) > 0.97 * walls(())


def test_marks_stand_where_they_belong(tmp_path: Path) -> None:
    spec, grid = office()

    def red(x: float) -> np.ndarray:
        mark = Mark(x, 4.5, "", "collision")
        picture = cv2.imread(str(draw_map_with_trajectory(tmp_path / "m.png", spec, grid, {}, marks=[mark]))).astype(
            int
        )
        return np.argwhere((picture[:, :, 2] > 200) & (picture[:, :, 1] < 60))

    assert len(red(1.0)) > 30
    assert red(1.0)[:, 1].mean() < red(3.0)[:, 1].mean() < red(5.0)[:, 1].mean()


def test_pictures_of_large_maps_are_reduced_and_keep_their_walls(tmp_path: Path) -> None:
    n, walls = 5000, range(307, 5000, 311)
    grid = np.zeros((n, n), np.int8)
    grid[:, walls] = 100
    picture = cv2.imread(str(draw_map_with_trajectory(tmp_path / "m.png", GridSpec(0.05, n, n, 0.0, 0.0), grid, {})))
    is_dark = (picture[300:-300].max(axis=2) < 130).mean(axis=0) > 0.9
    assert np.count_nonzero(np.diff(is_dark.astype(int)) == 1) in (len(walls), len(walls) + 1), "one more is the frame"
    assert darkest(np.full((7, 5, 3), 200, np.uint8), 3).shape == (3, 2, 3)
    small = np.zeros((7, 5, 3), np.uint8)
    assert darkest(small) is small


def test_a_small_known_part_of_a_large_grid_is_drawn_in_full(tmp_path: Path) -> None:
    spec, grid = office()
    large = np.full((3000, 3000), -1, np.int8)
    large[1000 : 1000 + spec.height, 500 : 500 + spec.width] = grid
    origin = (spec.origin_x - 500 * spec.resolution, spec.origin_y - 1000 * spec.resolution)
    around = GridSpec(spec.resolution, 3000, 3000, *origin)
    line = {"p": np.array([[1.0, 1.0, 0.0], [4.0, 1.0, 0.0]])}
    small = cv2.imread(str(draw_map_with_trajectory(tmp_path / "a.png", spec, grid, line))).astype(int)
    whole = cv2.imread(str(draw_map_with_trajectory(tmp_path / "b.png", around, large, line))).astype(int)
    assert small.shape == whole.shape
    assert ((small.max(axis=2) < 70) != (whole.max(axis=2) < 70)).mean() < 0.005


def test_a_table_refuses_rows_of_another_width(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="zip"):
        write_report(tmp_path, "t", {}, tables=[Table("t", ("a", "b"), ((1,),))])


def test_the_map_picture_shows_the_trajectory_where_it_was_driven(tmp_path: Path) -> None:
    spec, grid = office()
    without = cv2.imread(str(draw_map_with_trajectory(tmp_path / "a.png", spec, grid, {})))
    line = np.column_stack([np.linspace(0, 5, 50), np.full(50, 4.5)])
    with_path = cv2.imread(str(draw_map_with_trajectory(tmp_path / "b.png", spec, grid, {"p": line})))
    blue = (with_path[:, :, 0].astype(int) - with_path[:, :, 2] > 100).sum()
    assert blue > 500
    assert (without[:, :, 0].astype(int) - without[:, :, 2] > 100).sum() == 0


def test_glass_has_its_own_colour_where_it_stands(tmp_path: Path) -> None:
    spec, grid = office()

    def cyan(segments: list[list[float]]) -> np.ndarray:
        glass = np.array(segments, np.float32).reshape(-1, 4)
        picture = cv2.imread(str(draw_map_with_trajectory(tmp_path / "g.png", spec, grid, {}, (), glass))).astype(int)
        plan = picture[int(0.12 * len(picture)) :]  # below the legend
        return np.argwhere((plan[:, :, 0] - plan[:, :, 2] > 150) & (plan[:, :, 1] > 150))

    assert len(cyan([])) == 0
    low, high = cyan([[1.0, 1.0, 3.0, 1.0]]), cyan([[1.0, 3.0, 3.0, 3.0]])
    assert len(low) == pytest.approx(len(high), rel=0.05)
    assert low[:, 0].mean() > high[:, 0].mean() + 20, "y points up"
    assert np.ptp(low[:, 1]) == pytest.approx(2.0 * np.ptp(cyan([[1.0, 1.0, 2.0, 1.0]])[:, 1]), rel=0.05)


def test_eval_map_prints_and_writes_the_fields(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec, grid = office()
    save_map(tmp_path / "truth", spec, grid)
    partial = grid.copy()
    partial[:120, :100] = -1
    save_map(tmp_path / "built", spec, partial)
    parser = argparse.ArgumentParser()
    eval_map.add_parser(parser.add_subparsers())
    words = ["map", tmp_path / "built.yaml", tmp_path / "truth.yaml", "--out", tmp_path, "--json", tmp_path / "r.json"]
    args = parser.parse_args([str(w) for w in words])
    assert args.run(args) == 0
    record = json.loads((tmp_path / "r.json").read_text())
    expected = compare_maps((spec, partial), (spec, grid))
    for name in ("coverage_ratio", "false_free_ratio", "nne_cells", "nne_reverse_cells", "ssim"):
        assert record[name] == pytest.approx(getattr(expected, name))
    assert "coverage_ratio" in capsys.readouterr().out
    assert (tmp_path / "report.html").exists()
