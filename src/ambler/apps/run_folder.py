"""The folder of one run: recording, log, maps, configuration, report."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from pathlib import Path

LATEST = "LATEST"


class RunFolder:
    """Names every file of a run in one place."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(parents=True, exist_ok=True)

    @classmethod
    def new(cls, parent: Path, label: str) -> RunFolder:
        """Make a folder that did not exist, named by the time and a label."""
        name = f"{time.strftime('%Y%m%d-%H%M%S')}-{label}"
        for number in range(1000):
            root = parent / (name if number == 0 else f"{name}-{number}")
            try:
                root.mkdir(parents=True)
            except FileExistsError:
                continue
            return cls(root)
        raise FileExistsError(f"{parent} holds a thousand runs of this second")

    def link_latest(self) -> None:
        """Let the link `latest` beside the folder (LATEST in its name) lead here; where links cannot be made there is none."""
        link = self.root.parent / LATEST
        partial = self.root.parent / f".{LATEST}.{os.getpid()}"
        with contextlib.suppress(OSError):
            partial.symlink_to(self.root.name)
            os.replace(partial, link)

    def remove(self) -> None:
        """Remove the folder with everything in it: of a run that could not begin."""
        shutil.rmtree(self.root, ignore_errors=True)

    @property
    def recording(self) -> Path:
        return self.root / "recording"

    @property
    def log(self) -> Path:
        return self.root / "log.jsonl"

    @property
    def config(self) -> Path:
        return self.root / "config.yaml"

    @property
    def known_map_stem(self) -> Path:
        """The map that the robot was given."""
        return self.root / "known_map"

    @property
    def simulator(self) -> Path:
        """The folder of a simulator that ran in a process of its own."""
        return self.root / "simulator"

    @property
    def docks(self) -> Path:
        """The docks of the place, refined while docking."""
        return self.root / "docks.yaml"

    @property
    def first_docks(self) -> Path:
        """The docks as they were known when the run began."""
        return self.root / "docks_at_start.yaml"

    @property
    def map_stem(self) -> Path:
        return self.root / "map"

    @property
    def truth_stem(self) -> Path:
        return self.root / "truth"
