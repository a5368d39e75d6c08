#!/usr/bin/env bash
# What the commands of `thalweg` print for the twin's logs and shipped files -> results/commands, to be compared.
set -u
cd "$(dirname "$0")/../.."
out=results/commands
logs=results/tiny/simulation/logs
mkdir -p "$out"
run() { .venv/bin/python -m thalweg "${@:2}" > "$out/$1.txt" 2>&1; echo "exit $?" >> "$out/$1.txt"; }
run describe describe "$logs"/lidar.pcap "$logs"/ins.anpp "$logs"/rover.sbp "$logs"/ppk.pos "$logs"/echo.nmea "$logs"/tls_1.laz
run describe_json describe --json "$logs"/lidar.pcap "$logs"/ins.anpp
run describe_field describe results/field_tiny/simulation/logs/field.yaml
run summary summary results/tiny
run check_config check-config config/campaigns/*.yaml
for file in resources/budgets/*.yaml; do run "budget_$(basename "$file" .yaml)" budget "$file"; done
