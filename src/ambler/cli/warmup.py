"""`ambler warmup`: compile every kernel now, so that no run has to."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("warmup", help="compile the kernels now (once per installation)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compile and report."""
    from ambler.kernels.warmup import kernel_modules, warm_up

    seconds = warm_up(kernel_modules())
    print(f"kernels ready in {seconds:.1f} s")
    return 0
