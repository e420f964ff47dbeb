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

import numpy as np

from ambler.core.messages import Frontier, FrontierState
from ambler.evaluation.collisions import Collision
from ambler.evaluation.metrics import Group, is_known, length, metric_of, ordered, plain_text, shown
from ambler.wire.atomic_file import write_whole

_STYLE = """
:root { --ink: #1f2430; --muted: #6b7280; --line: #e5e7eb; --paper: #f8f9fb; --good: #059669; --bad: #dc2626; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 0; }
main { max-width: 1180px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 26px; margin: 0 0 4px; } h2 { font-size: 18px; margin: 36px 0 12px; } h2.group { margin: 22px 0 8px; font-size: 15px; }
.sub { color: var(--muted); margin: 0 0 24px; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(215px, 1fr)); gap: 12px; }
.card { background: white; border: 1px solid var(--line); border-radius: 10px; padding: 12px 14px; }
.card b { display: block; font-size: 21px; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.card span { display: block; font-size: 13px; font-weight: 600; }
.card small { display: block; color: var(--muted); font-size: 12px; line-height: 1.35; margin-top: 4px; }
.verdict { background: white; border: 1px solid var(--line); border-left: 8px solid var(--muted); border-radius: 10px; padding: 12px 18px; }
.verdict b { display: block; font-size: 22px; }
.verdict.good { border-left-color: var(--good); } .verdict.bad { border-left-color: var(--bad); }
.print { color: var(--muted); font-size: 12px; overflow-wrap: anywhere; margin: 6px 0; }
.good b { color: var(--good); } .bad b { color: var(--bad); }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); gap: 16px; align-items: start; }
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


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG file and what it shows."""

    caption: str
    path: Path


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a title; an empty one shows `empty` instead. `note` is a line below the title."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    empty: str = "none"
    note: str = ""


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

    `results` are flat values whose names carry their units; `metrics` says what they mean and which come first. `passed` colours
    results that have a bar green or red. `configuration` is text that is shown folded.
    """
    folder.mkdir(parents=True, exist_ok=True)
    marks = passed or {}
    body = [f"<h1>{html.escape(title)}</h1>", f'<p class="sub">{html.escape(subtitle)}</p>' if subtitle else ""]
    body.append(_verdict(results, marks))
    body += _groups(results, marks)
    if pictures:
        body.append(f'<h2>Pictures</h2><div class="pictures">{"".join(_figure(p) for p in pictures)}</div>')
    body += [_table(t) for t in tables]
    if configuration:
        shown = html.escape(configuration)
        body.append(f"<details><summary>Configuration</summary><pre>{shown}</pre></details>")
    body.append(_small_print(results))
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
        "notes": {t.title: t.note for t in tables if t.note},
        "tables": {t.title: [dict(zip(t.columns, map(_plain, r), strict=True)) for r in t.rows] for t in tables},
        "pictures": {p.caption: p.path.name for p in pictures},
    }
    write_whole(folder / "report.json", json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    return path


def frontier_table(frontiers: Sequence[Frontier]) -> Table:
    """List the frontiers that remain, each with its reason; those that are too small are dust, told in one line."""
    dust = [f for f in frontiers if f.state is FrontierState.TOO_SMALL]
    rows = tuple(
        (f.state.name.lower().replace("_", " "), f.reason, f"{f.centroid[0]:.2f}, {f.centroid[1]:.2f}", len(f.cells))
        for f in frontiers
        if f.state is not FrontierState.TOO_SMALL
    )
    note = ""
    if dust:
        longest = max(float(np.hypot(*np.ptp(f.cells, axis=0))) for f in dust)
        note = (
            f"{len(dust)} more are dust, too small to be worth a look: the longest is {length(longest)} from end to end"
        )
    empty = "no frontier is left" if not dust else "no other frontier is left"
    return Table("Frontiers that remain", ("state", "reason", "middle (m)", "cells"), rows, empty, note)


def collision_table(collisions: Sequence[Collision], *, is_whole: bool = True) -> Table:
    """List the collisions; if the list is not whole, that nothing stands in it tells nothing."""
    rows = tuple(
        (f"{c.begin_ns * 1e-9:.2f}", c.robot_geom, c.other_geom, f"{c.speed:.2f}", f"{c.force:.1f}") for c in collisions
    )
    columns = ("time (s)", "robot", "touched", "speed (m/s)", "force (N)")
    title = "Collisions" if is_whole else "Collisions, as far as they are known"
    return Table(title, columns, rows, "no collision" if is_whole else "none until the recording ends")


def _verdict(results: Mapping[str, Any], marks: Mapping[str, bool]) -> str:
    """The first thing to see: how it ended, and why."""
    if results.get("ended") is None:
        return ""
    ended = str(results["ended"]).replace("_", " ")
    kind = {True: " good", False: " bad"}.get(marks["ended"], "") if "ended" in marks else ""
    hits = results.get("collisions")
    told = [str(results.get("text") or "")] + ([f"{hits} collisions" if hits > 1 else "a collision"] if hits else [])
    why = "; ".join(text for text in told if text) or "everything that was asked was done"
    return f'<div class="verdict{kind}"><b>{html.escape(ended)}</b>{html.escape(why)}</div>'


def _groups(results: Mapping[str, Any], marks: Mapping[str, bool]) -> list[str]:
    """The cards of what is known, what matters first."""
    out = []
    names = [name for name in ordered(list(results)) if name not in ("ended", "text") and is_known(results[name])]
    for group in Group:
        cards = [_card(name, results[name], marks.get(name)) for name in names if metric_of(name).group is group]
        if cards and group not in (Group.SETTING, Group.SMALL):
            out.append(f'<h2 class="group">{group.value}</h2><div class="cards">{"".join(cards)}</div>')
    return out


def _card(name: str, value: Any, is_passed: bool | None) -> str:
    metric = metric_of(name)
    kind = "" if is_passed is None else (" good" if is_passed else " bad")
    told = f"<small>{html.escape(metric.meaning)}</small>" if metric.meaning else ""
    label, text = html.escape(metric.label), html.escape(shown(name, value))
    return f'<div class="card{kind}" title="{html.escape(name)}"><b>{text}</b><span>{label}</span>{told}</div>'


def _small_print(results: Mapping[str, Any]) -> str:
    """What only a later look needs: what was given, where the files are, and what is not known."""
    lines = []
    for group in (Group.SETTING, Group.SMALL):
        names = [name for name in results if metric_of(name).group is group and is_known(results[name])]
        lines.append(", ".join(f"{metric_of(name).label}: {results[name]}" for name in ordered(names)))
    unknown = [metric_of(n).label for n in results if not is_known(results[n]) and n not in ("ended", "text")]
    lines.append(f"Not known of this run: {', '.join(unknown)}" if unknown else "")
    return "".join(f'<p class="print">{html.escape(line)}</p>' for line in lines if line)


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    caption = html.escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _table(table: Table) -> str:
    title = f"<h2>{html.escape(table.title)}</h2>"
    if table.note:
        title += f"<p>{html.escape(table.note)}</p>"
    if not table.rows:
        return f"{title}<p>{html.escape(table.empty)}</p>"
    head = "".join(f"<th>{html.escape(c)}</th>" for c in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{html.escape(plain_text(v))}</td>" for v in r) + "</tr>" for r in table.rows)
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold; what is not finite is null."""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
