#!/usr/bin/env bash
# Make .venv from envs/requirements.lock. Works without root, and without the system's venv or pip packages
# as long as one of {ensurepip, pip, virtualenv, uv} is there.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=.venv
lock=envs/requirements.lock

fail() { printf '\nThalweg: %s\n' "$*" >&2; exit 2; }

works() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' >/dev/null 2>&1; }
if [ -n "${PYTHON:-}" ]; then
    works "$PYTHON" || fail "PYTHON=$PYTHON is not Python 3.11, 3.12 or 3.13."
else
    for candidate in python3.13 python3.12 python3.11 python3; do
        if command -v "$candidate" >/dev/null && works "$candidate"; then PYTHON=$candidate; break; fi
    done
    [ -n "${PYTHON:-}" ] || fail "no Python 3.11, 3.12 or 3.13 on the PATH. Install one, or name it: make env PYTHON=/path/to/python3."
fi

free_kb=$(df -Pk . | awk 'NR == 2 { print $4 }')
[ "$free_kb" -gt 3000000 ] || fail "$((free_kb / 1000)) MB free here; the environment needs 3 GB."

echo "Making $venv with $("$PYTHON" --version) ..."
rm -rf "$venv"
if "$PYTHON" -c 'import ensurepip' 2>/dev/null; then
    "$PYTHON" -m venv "$venv"
    install=("$venv/bin/python" -m pip install)
elif "$PYTHON" -m pip --version >/dev/null 2>&1; then
    # Debian without python3-venv: pip of the system fills an environment that has none of its own.
    "$PYTHON" -m venv --without-pip "$venv"
    install=("$PYTHON" -m pip --python "$venv/bin/python" install)
elif command -v uv >/dev/null; then
    uv venv --quiet --python "$PYTHON" "$venv"
    install=(uv pip install --python "$venv/bin/python")
elif "$PYTHON" -m virtualenv --version >/dev/null 2>&1; then
    "$PYTHON" -m virtualenv --quiet "$venv"
    install=("$venv/bin/python" -m pip install)
else
    fail "this Python has neither ensurepip nor pip, and there is no uv. Ask for the package python3-venv (or python3-pip)."
fi

echo "Installing the locked packages (about 500 MB to fetch, one to five minutes) ..."
"${install[@]}" --quiet --require-hashes -r "$lock"
"${install[@]}" --quiet --no-deps --no-build-isolation -e .
"$venv/bin/python" -m thalweg --version
touch "$venv/.complete"
