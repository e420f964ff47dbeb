"""Calls every kernel once with its real types, so that none compiles while a robot moves. Shows a line while the cache is cold."""

from __future__ import annotations

import hashlib
import importlib
import os
import pkgutil
import subprocess
import sys
import time
from pathlib import Path

import ambler.kernels

_NOT_KERNELS = {"jit", "warmup"}


def kernel_modules() -> list[str]:
    """Return the names of all kernel modules."""
    names = [m.name for m in pkgutil.iter_modules(ambler.kernels.__path__)]
    return sorted(n for n in names if n not in _NOT_KERNELS)


def imported_kernel_modules() -> list[str]:
    """Return the names of the kernel modules that this program has imported so far: those that it can call."""
    return [name for name in kernel_modules() if f"ambler.kernels.{name}" in sys.modules]


def warm_up(names: list[str]) -> float:
    """Warm up kernel modules; returns the seconds that it took. Shows a line of progress only when it has to compile.

    A cold cache is filled by two processes, each with half of the modules.
    """
    started = time.monotonic()
    importlib.import_module("ambler.kernels.jit")
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    mark = folder / f"warm-{hashlib.sha256(' '.join(names).encode()).hexdigest()[:16]}"
    if mark.exists():
        _call(names)
        return time.monotonic() - started
    folder.mkdir(parents=True, exist_ok=True)
    half = names[1::2] if (os.cpu_count() or 1) > 1 else []
    helper = subprocess.Popen([sys.executable, "-m", "ambler.kernels.warmup", *half]) if half else None
    for i, name in enumerate(n for n in names if n not in half):
        done = 2 * i if half else i
        text = f"compiling kernels, once: {done}/{len(names)} {name} ({time.monotonic() - started:.0f} s)"
        print(f"\r{text:<70}", end="", file=sys.stderr, flush=True)
        _call([name])
    if helper is not None and helper.wait() != 0:
        print("\nthe second compiling process failed; going on alone", file=sys.stderr)
    _call(half)
    seconds = time.monotonic() - started
    print(f"\r{f'kernels compiled in {seconds:.0f} s':<70}", file=sys.stderr, flush=True)
    mark.touch()
    return seconds


def _call(names: list[str]) -> None:
    for name in names:
        importlib.import_module(f"ambler.kernels.{name}").warm_up()


def compiled_signatures() -> dict[str, int]:
    """Return the number of compiled signatures of every kernel, to prove that a run compiled none."""
    counts = {}
    for name in kernel_modules():
        module = importlib.import_module(f"ambler.kernels.{name}")
        for attribute, value in vars(module).items():
            signatures = getattr(value, "signatures", None)
            if signatures is not None:
                counts[f"{name}.{attribute}"] = len(signatures)
    return counts


if __name__ == "__main__":
    _call(sys.argv[1:])
