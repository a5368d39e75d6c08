#!/usr/bin/env bash
# Static checks of the workflow: the linter, and a dry run of all shipped campaigns.
set -euo pipefail
cd "$(dirname "$0")/.."
snakemake=.venv/bin/snakemake
$snakemake --lint
campaigns=$(basename -s .yaml config/campaigns/*.yaml | paste -sd,)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
$snakemake --directory "$scratch" --config "campaign=[$campaigns]" --dry-run --quiet all >"$scratch/log" 2>&1 ||
    { cat "$scratch/log"; echo "dry run of the shipped campaigns failed" >&2; exit 1; }
echo "dry run of $campaigns: ok"
