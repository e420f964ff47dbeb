"""`ambler eval map BUILT TRUTH`: coverage, nearest-neighbour errors and structural similarity of a map, with an overlay picture."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.evaluation.map_quality import MapQuality


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("map", help="compare a built map with the true one")
    parser.add_argument("built", type=Path, help="the built map, .yaml")
    parser.add_argument("truth", type=Path, help="the true map, .yaml")
    parser.add_argument("--out", type=Path, help="folder for overlay.png and report.html")
    parser.add_argument("--seed", type=int, default=0, help="unused: nothing is random here")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def quality_fields(quality: MapQuality) -> dict[str, float]:
    """Return the flat fields of a comparison, named as everywhere in the project."""
    return {
        "coverage_ratio": quality.coverage_ratio,
        "false_free_ratio": quality.false_free_ratio,
        "nne_cells": quality.nne_cells,
        "nne_reverse_cells": quality.nne_reverse_cells,
        "ssim": quality.ssim,
        "alignment_x_m": quality.truth_from_built.x,
        "alignment_y_m": quality.truth_from_built.y,
        "alignment_yaw_rad": quality.truth_from_built.yaw,
    }


def run(args: argparse.Namespace) -> int:
    """Compare, print a small table, and write what is asked for."""
    from ambler.evaluation.map_quality import compare_maps
    from ambler.evaluation.pictures import draw_overlay
    from ambler.evaluation.report import Picture, write_report
    from ambler.evaluation.results import write_results
    from ambler.wire.map_files import load_map

    begin = time.perf_counter()
    quality = compare_maps(load_map(args.built), load_map(args.truth))
    fields = quality_fields(quality)
    for name, value in fields.items():
        print(f"{name:20} {value: .4f}")
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        overlay = draw_overlay(quality, args.out / "overlay.png")
        title = f"{args.built.stem} against {args.truth.stem}"
        path = write_report(args.out, title, fields, [Picture("Truth red, built map blue, both violet", overlay)])
        print(f"report: {path}")
    if args.json is not None:
        write_results(args.json, "eval map", args.seed, time.perf_counter() - begin, fields)
    return 0
