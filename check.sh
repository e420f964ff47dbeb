#!/usr/bin/env bash
# All of continuous integration: format, lint, types, architecture, tests. `--all` adds the heavier suites.
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
ambler_setup sim,dev
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg
if [ -z "${AMBLER_DATA:-}" ] && [ -d ../shared/data ]; then export AMBLER_DATA="$PWD/../shared/data"; fi  # docs/datasets.md
echo "== format"
.venv/bin/ruff format --check .
echo "== lint"
.venv/bin/ruff check .
echo "== types"
.venv/bin/mypy
echo "== kernels"
.venv/bin/ambler warmup
echo "== tests"
if [ "${1:-}" = "--all" ]; then
    shift
    .venv/bin/pytest "$@"
else
    .venv/bin/pytest -m "not slow" "$@"
fi
