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
echo "== types and, on the other core, kernels"
.venv/bin/mypy & types=$!
.venv/bin/ambler warmup
wait "$types"
chosen="not slow"
if [ "${1:-}" = "--all" ]; then
    shift
    chosen="slow or not slow"
fi
run_tests() { .venv/bin/pytest "$@" || [ $? -eq 5 ]; } # 5: whoever named some tests named none of these
echo "== tests on the wall clock, one by one"
run_tests --durations=15 --durations-min=3 -m "live and ($chosen)" "$@"
echo "== tests"
run_tests -n auto --durations=25 --durations-min=4 -m "not live and ($chosen)" "$@"
