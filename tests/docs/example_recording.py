"""Makes the small recording of examples/lab_empty anew: `python -m tests.docs.example_recording`, after a change of what a node tells.

`made_on` names the processor and the libraries it was made with: on the same ones a replay must come out equal, bit by bit.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding as llvm

from tests.docs.commands import ROOT

EXAMPLE = ROOT / "examples" / "lab_empty"
MADE_ON = EXAMPLE / "made_on"
COMMAND = "demo --world lab_empty --start 2,2,-45 --exit --no-view"
KEPT = ("config.yaml", "map.yaml", "map.pgm", "recording")


def processor() -> str:
    """Return what decides about the last bits of a run: the processor's kind and the versions of the numeric libraries."""
    libraries = " ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
    return f"{platform.machine()} {llvm.get_host_cpu_name()} {libraries}"


def main() -> int:
    """Run the demonstration and keep what the example consists of."""
    with tempfile.TemporaryDirectory() as name:
        words = [sys.executable, "-m", "ambler.cli.main", *COMMAND.split(), "--out", name]
        subprocess.run(words, check=True)
        run = next(Path(name).rglob("config.yaml")).parent
        shutil.rmtree(EXAMPLE)
        EXAMPLE.mkdir()
        for part in KEPT:
            shutil.move(run / part, EXAMPLE / part)
    MADE_ON.write_text(processor() + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
