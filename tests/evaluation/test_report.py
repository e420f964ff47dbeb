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
from ambler.core.messages import Frontier, FrontierState
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.map_quality import compare_maps
from ambler.evaluation.pictures import draw_map_with_trajectory, draw_overlay, draw_series
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
    assert "99.12 %" in text
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    embedded = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert [base64.b64decode(e) for e in embedded] == [p.path.read_bytes() for p in pictures]
    record = json.loads((tmp_path / "report.json").read_text())
    assert record["results"] == {**results, "ate_rms_m": None}
    assert record["tables"]["Frontiers that remain"][0]["reason"] == "behind <glass>"


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
