"""The tables of results, made from the files in docs/results: all rows in docs/results.md, the headlines in the README."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ambler.evaluation.bars import docked, explored, large_worlds, lived, localized, planned, three_dimensions
from ambler.evaluation.bars.row import Row
from ambler.evaluation.docking import shapes_table, table

ROWS: Sequence[Row] = (
    *explored.ROWS,
    *planned.ROWS,
    *large_worlds.ROWS,
    *localized.ROWS,
    *three_dimensions.ROWS,
    *docked.ROWS,
    *lived.ROWS,
)


HEADLINES = ("run_office", "exploration_lab", "slam2d_intel", "docking", "relocalization", "live")
"""Files whose first row stands in the README, too."""

PAGE = """# Results

Made by `ambler eval results` from the files in [results](results); each tells the command that made it, the commit, the day, the machine, the seed
and the seconds. A row measured on an earlier day was measured on an earlier state of the code. A row that misses its bar says so.

Unless a row says drawn, worlds, logs and seeds are those on which Ambler was developed. On places that nobody had tried it has done worse: of drawn
ones only a few runs were made so far (campuses, explorations, made maps, LiDAR-inertial odometry, docking with imperfections).

"""


def results_table(folder: Path, link: str = "results", files: Collection[str] = ()) -> str:
    """Return the table in Markdown; a row whose file is absent says so instead of showing a number. `link` is the way from the page to
    the folder; with `files` only the first row of each of them is shown."""
    lines = ["| what | bar | measured |", "|---|---|---|"]
    machines, wanted = set(), [f"{name}.json" for name in files]
    for row in ROWS:
        if files and row.file not in wanted:
            continue
        wanted = [name for name in wanted if name != row.file]
        path = folder / row.file
        if path.exists():
            fields = {name.replace(".", "_"): value for name, value in json.loads(path.read_text()).items()}
            machines.add(fields["machine"])
            lines.append(f"| {row.what} | {row.bar} | {_fill(row, fields)} ([{fields['date']}]({link}/{row.file})) |")
        else:
            lines.append(f"| {row.what} | {row.bar} | not measured yet |")
    return "\n".join([*lines, "", f"Each on the day behind it, on: {'; '.join(sorted(machines)) or 'nothing yet'}."])


def update_page(page: Path, folder: Path) -> None:
    """Write the page of all results."""
    page.write_text(PAGE + results_table(folder) + "\n", encoding="utf-8")


def update_readme(readme: Path, folder: Path) -> None:
    """Replace what stands between the marks of the README by the headlines."""
    _replace(readme, "results", results_table(folder, "docs/results", HEADLINES))


def update_docking(page: Path, folder: Path) -> None:
    """Replace what stands between the marks of the page on docking by the tables of its results."""
    camera, notch, reflectors = (
        json.loads((folder / f"{name}.json").read_text())
        for name in ("docking", "docking_v_shape", "docking_reflectors")
    )
    _replace(page, "docking", table(camera))
    _replace(page, "shapes", shapes_table({"V-shaped notch": notch, "reflectors": reflectors}))


def _replace(page: Path, name: str, text: str) -> None:
    """Put a text between `<!-- name -->` and `<!-- /name -->`."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    _, _, after = rest.partition(end)
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def _fill(row: Row, fields: dict[str, Any]) -> str:
    try:
        return row.text.format(**fields) + ("" if row.is_met(fields) else " **(misses the bar)**")
    except (KeyError, TypeError, ValueError) as error:
        return f"incomplete ({error})"
