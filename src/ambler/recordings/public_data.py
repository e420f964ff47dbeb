"""Recordings that other people published, in the folder that the environment variable AMBLER_DATA names (docs/datasets.md)."""

from __future__ import annotations

import os
from pathlib import Path

from ambler.core.errors import BadInputError

VARIABLE = "AMBLER_DATA"


def public_data(name: str) -> Path:
    """Return the file or folder `name`, such as `radish/intel.clf.bz2`; raises BadInputError when it is not there."""
    if not (root := os.environ.get(VARIABLE)):
        raise BadInputError(f"{name} is public data: set {VARIABLE} to the folder that holds it (docs/datasets.md)")
    path = Path(root) / name
    if not path.exists():
        raise BadInputError(f"{path}: not in the folder of {VARIABLE} (docs/datasets.md)")
    return path
