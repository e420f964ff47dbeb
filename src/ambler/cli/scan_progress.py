"""How far the work through a recording is: a bar on the terminal, with the time that is left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

STEP = 20  # scans between two drawings: a log gives hundreds a second


@contextmanager
def scan_progress(doing: str, scans: int) -> Iterator[Callable[[], None]]:
    """Show a bar on standard error; yields what is to be called after each scan."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(doing),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("scans, elapsed"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    done = 0
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=2) as progress:
        task = progress.add_task("", total=scans)

        def on_scan() -> None:
            nonlocal done
            done += 1
            if done % STEP == 0 or done == scans:
                progress.update(task, completed=done)

        yield on_scan
