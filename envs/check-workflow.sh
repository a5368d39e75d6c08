#!/usr/bin/env bash
# Static checks of the workflow: the linter, and a dry run of every shipped campaign.
set -euo pipefail
cd "$(dirname "$0")/.."
snakemake=.venv/bin/snakemake
$snakemake --lint
for campaign in config/campaigns/*.yaml; do
    id=$(basename "$campaign" .yaml)
    scratch=$(mktemp -d)
    $snakemake --directory "$scratch" --config "campaign=$id" --dry-run --quiet all >"$scratch/log" 2>&1 ||
        { cat "$scratch/log"; echo "dry run of $campaign failed" >&2; exit 1; }
    rm -rf "$scratch"
    echo "dry run of campaign $id: ok"
done
