# Sourced by run.sh and check.sh: makes .venv with pinned versions and installs Ambler into it. Safe to repeat.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
ambler_setup() { # $1: the extras to install, for example sim,dev
    local python=""
    for candidate in python3 python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            python=$candidate
            break
        fi
    done
    if [ -z "$python" ]; then
        echo "Ambler needs Python 3.11 or newer; install it and start again." >&2
        return 2
    fi
    if ! [ -x .venv/bin/python ]; then
        echo "setting up .venv with $($python --version) ..."
        if ! "$python" -m venv .venv; then
            rm -rf .venv
            echo "Python's venv module is missing (Debian and Ubuntu: install the package python3-venv)." >&2
            return 2
        fi
    fi
    local wanted
    wanted=$(cat pyproject.toml constraints.txt | cksum)" $1"
    if [ "$(cat ".venv/installed-$1" 2>/dev/null)" != "$wanted" ]; then
        echo "installing packages ($1), a few minutes the first time ..."
        .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[$1]"
        echo "$wanted" >".venv/installed-$1"
    fi
}
