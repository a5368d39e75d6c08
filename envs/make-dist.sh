#!/usr/bin/env bash
# sdist and wheel into dist/, checked: two builds have the same bytes, and so has a wheel that is built from the
# sdist; in an empty environment of each Python from 3.11 to 3.13 that is there the wheel is installed with its
# dependencies at the versions of the lock, without extras: `thalweg init`, a dry run of `tiny`, and a product of
# an extra, which must be refused with the extra's name. THALWEG_DIST_PYTHONS chooses interpreters.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
scratch=$(mktemp -d "${TMPDIR:-/tmp}/thalweg-dist.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
fail() { echo "make dist: $*" >&2; exit 1; }
build() { (cd "$1" && "$root/.venv/bin/python" -m hatchling build "${@:3}" -d "$2" >/dev/null 2>&1) || fail "no build in $1"; }

rm -rf dist
build . dist
build . "$scratch/again"
tar -xzf dist/thalweg-*.tar.gz -C "$scratch"
build "$scratch"/thalweg-*/ "$scratch/of_sdist" -t wheel
for made in dist/*; do
    cmp "$made" "$scratch/again/$(basename "$made")" || fail "two builds differ"
done
cmp dist/*.whl "$scratch"/of_sdist/*.whl || fail "the wheel of the sdist differs"
echo "the same bytes twice: $(cd dist && sha256sum -- * | cut -c1-12,65-)" | tr '\n' ' '
echo

sed -nE 's/^([A-Za-z0-9._-]+==[^ \\]+( ; [^\\]+)?) *\\?$/\1/p' envs/requirements.lock >"$scratch/constraints.txt"
for python in ${THALWEG_DIST_PYTHONS:-python3.11 python3.12 python3.13}; do
    "$python" -c '' 2>/dev/null || { echo "$python: not here, not tried"; continue; }
    "$python" -m venv "$scratch/$python"
    own=$scratch/$python/bin
    "$own/python" -m pip install --quiet --constraint "$scratch/constraints.txt" dist/*.whl
    size=$(du -sm "$scratch/$python" | cut -f1)
    (
        cd "$scratch" && unset PYTHONPATH
        "$own/thalweg" init "work_$python" >/dev/null && cd "work_$python"
        "$own/thalweg" run tiny -n --quiet all >log 2>&1 || { tail log >&2; fail "no dry run of tiny by $python"; }
        "$own/thalweg" print-markers markers.pdf --ids 0-3 >refused 2>&1 && fail "print-markers without its extra"
        grep -q "thalweg\[images\]" refused || { cat refused >&2; fail "the refusal names no extra"; }
    )
    echo "$python: installed ($size MB with pip), dry run of tiny, refusal with the extra's name: ok"
    rm -rf "${scratch:?}/$python"
done
