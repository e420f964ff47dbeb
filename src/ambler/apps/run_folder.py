"""The folder of one run: recording, log, maps, configuration, report."""

from __future__ import annotations

import time
from pathlib import Path


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
    def map_stem(self) -> Path:
        return self.root / "map"

    @property
    def truth_stem(self) -> Path:
        return self.root / "truth"
