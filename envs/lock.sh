#!/usr/bin/env bash
# Renew envs/requirements.lock from pyproject.toml: one lock for Python 3.11 to 3.13 on any platform, with hashes;
# and envs/docs.lock, what the site of the documentation needs on top, at versions that go with the first.
# Needs uv on the PATH. The locks name no registry host.
set -euo pipefail
cd "$(dirname "$0")/.."
uv pip compile pyproject.toml --extra all --extra dev --extra hpc --universal --python-version 3.11 \
    --generate-hashes --no-emit-index-url --no-header --output-file envs/requirements.lock "$@"
uv pip compile --group docs --constraints envs/requirements.lock --universal --python-version 3.11 \
    --generate-hashes --no-emit-index-url --no-header --output-file envs/docs.lock "$@"
