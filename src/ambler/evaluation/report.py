"""The report of a run: one self-contained HTML page (pictures embedded) and the same results as JSON."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.core.messages import Frontier
from ambler.evaluation.collisions import Collision
from ambler.wire.atomic_file import write_whole

_STYLE = """
:root { --ink: #1f2430; --muted: #6b7280; --line: #e5e7eb; --paper: #f8f9fb; --good: #059669; --bad: #dc2626; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 0; }
main { max-width: 1180px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 26px; margin: 0 0 4px; } h2 { font-size: 18px; margin: 36px 0 12px; }
.sub { color: var(--muted); margin: 0 0 24px; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(165px, 1fr)); gap: 12px; }
.card { background: white; border: 1px solid var(--line); border-radius: 10px; padding: 12px 14px; }
.card b { display: block; font-size: 21px; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.card span { color: var(--muted); font-size: 13px; }
.good b { color: var(--good); } .bad b { color: var(--bad); }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); gap: 16px; }
figure { margin: 0; background: white; border: 1px solid var(--line); border-radius: 10px; padding: 14px; }
figure img { width: 100%; height: auto; max-height: 820px; object-fit: contain; display: block; }
figcaption { color: var(--muted); font-size: 13px; margin-top: 8px; }
table { border-collapse: collapse; background: white; width: 100%; border: 1px solid var(--line); }
th, td { text-align: left; padding: 6px 12px; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--muted); font-weight: 600; font-size: 13px; } td { font-variant-numeric: tabular-nums; }
details { margin-top: 36px; } summary { cursor: pointer; font-size: 18px; font-weight: 600; }
pre { background: white; border: 1px solid var(--line); border-radius: 10px; padding: 14px; overflow: auto; font-size: 13px; }
@media (max-width: 560px) { .pictures { grid-template-columns: 1fr; } }
"""
_UNITS = {
    "m": "m",
    "s": "s",
    "ms": "ms",
    "hz": "Hz",
    "deg": "°",
    "rad": "rad",
    "pct": "%",
    "cells": "cells",
    "m2": "m²",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG file and what it shows."""

    caption: str
    path: Path


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a title; an empty one shows `empty` instead."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    empty: str = "none"


def write_report(
    folder: Path,
    title: str,
    results: Mapping[str, Any],
    pictures: Sequence[Picture] = (),
    tables: Sequence[Table] = (),
    *,
    subtitle: str = "",
    configuration: str = "",
    passed: Mapping[str, bool] | None = None,
) -> Path:
    """Write `report.html` and `report.json` into a folder; returns the path of the page.

    `results` are flat values whose names carry their units. `passed` colours results that have a bar green or red.
    `configuration` is text that is shown folded.
    """
    folder.mkdir(parents=True, exist_ok=True)
    marks = passed or {}
    body = [f"<h1>{html.escape(title)}</h1>", f'<p class="sub">{html.escape(subtitle)}</p>' if subtitle else ""]
    cards = [_card(name, value, marks.get(name)) for name, value in results.items()]
    body.append(f'<div class="cards">{"".join(cards)}</div>')
    if pictures:
        body.append(f'<h2>Pictures</h2><div class="pictures">{"".join(_figure(p) for p in pictures)}</div>')
    body += [_table(t) for t in tables]
    if configuration:
        shown = html.escape(configuration)
        body.append(f"<details><summary>Configuration</summary><pre>{shown}</pre></details>")
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main>{''.join(body)}</main></body></html>\n"
    )
    path = folder / "report.html"
    write_whole(path, page)
    record = {
        "title": title,
        "subtitle": subtitle,
        "results": {k: _plain(v) for k, v in results.items()},
        "passed": dict(marks),
        "tables": {t.title: [dict(zip(t.columns, map(_plain, r), strict=True)) for r in t.rows] for t in tables},
        "pictures": {p.caption: p.path.name for p in pictures},
    }
    write_whole(folder / "report.json", json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    return path


def frontier_table(frontiers: Sequence[Frontier]) -> Table:
    """List the frontiers that remain, each with its reason."""
    rows = tuple((f.state.name, f.reason, f"{f.centroid[0]:.2f}, {f.centroid[1]:.2f}", len(f.cells)) for f in frontiers)
    return Table("Frontiers that remain", ("state", "reason", "middle (m)", "cells"), rows, "no frontier is left")


def collision_table(collisions: Sequence[Collision]) -> Table:
    """List the collisions."""
    rows = tuple(
        (f"{c.begin_ns * 1e-9:.2f}", c.robot_geom, c.other_geom, f"{c.speed:.2f}", f"{c.force:.1f}") for c in collisions
    )
    columns = ("time (s)", "robot", "touched", "speed (m/s)", "force (N)")
    return Table("Collisions", columns, rows, "no collision")


def _card(name: str, value: Any, is_passed: bool | None) -> str:
    words = name.split("_")
    unit = _UNITS.get(words[-1], "") if len(words) > 1 else ""
    label = " ".join(words[:-1] if unit else words)
    kind = "" if is_passed is None else (" good" if is_passed else " bad")
    shown = f"{_text(value)} {unit}".strip() if value is not None else "unknown"
    if words[-1] == "ratio" and isinstance(value, int | float) and math.isfinite(value):
        shown, label = f"{100 * float(value):.2f} %", " ".join(words[:-1])
    return f'<div class="card{kind}"><b>{html.escape(shown)}</b><span>{html.escape(label)}</span></div>'


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "unknown"
        return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return str(value)


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    caption = html.escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _table(table: Table) -> str:
    title = f"<h2>{html.escape(table.title)}</h2>"
    if not table.rows:
        return f"{title}<p>{html.escape(table.empty)}</p>"
    head = "".join(f"<th>{html.escape(c)}</th>" for c in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{html.escape(_text(v))}</td>" for v in r) + "</tr>" for r in table.rows)
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold; what is not finite is null."""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
