#!/usr/bin/env bash
# Sets everything up and runs the main job: a simulated robot explores an unknown building. Options: see `ambler demo --help`.
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
ambler_setup sim
exec .venv/bin/ambler demo "$@"
