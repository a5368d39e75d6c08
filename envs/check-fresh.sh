#!/usr/bin/env bash
# Does the first command of the README work on a machine that has never seen Thalweg?
#
#     envs/check-fresh.sh [-k]        -k keeps the clone and prints where it is
#
# Clones the commit HEAD (changes that are not committed are not in it) into a new temporary folder and runs there,
# with an empty home folder, PATH=/usr/bin:/bin and an empty environment, `make demo SIZE=tiny` twice. The first call
# sets up .venv from the lock file: one to five minutes, 500 MB to fetch, 3 GB in the temporary folder (TMPDIR chooses
# its place). The second call must say "Nothing to be done" and must leave every cloud, table and picture as it was.
# Prints date, commit, Python, cores and wall times; ends with 0 if all is as promised, else with 1 and the log's end.
#
# Of the caller's environment only these are handed on, where set: what pip needs to reach its index (PIP_*, the proxy
# variables, the certificate variables) and PYTHON, which names an interpreter outside /usr/bin. Their names are
# printed: with PIP_FIND_LINKS or PIP_INDEX_URL among them, packages may come from elsewhere than the public index
# (their hashes are checked all the same). Not part of the tests.
set -euo pipefail
repository=$(cd "$(dirname "$0")/.." && pwd)

keep=no
case "${1:-}" in
    "") ;;
    -k) keep=yes ;;
    *) awk 'NR > 1 { if (!/^#/) exit; sub(/^# ?/, ""); print }' "$0" >&2; exit 2 ;;
esac

scratch=$(mktemp -d "${TMPDIR:-/tmp}/thalweg-fresh.XXXXXX")
finish() {
    if [ "$keep" = yes ]; then echo "kept: $scratch"; else rm -rf "$scratch"; fi
}
trap finish EXIT
home=$scratch/home
clone=$scratch/thalweg
mkdir "$home" "$scratch/tmp"

handed_on=()
while IFS='=' read -r -d '' name value; do
    case "$name" in
        PIP_* | SSL_CERT_FILE | SSL_CERT_DIR | REQUESTS_CA_BUNDLE | CURL_CA_BUNDLE | PYTHON | \
            HTTP_PROXY | HTTPS_PROXY | NO_PROXY | http_proxy | https_proxy | no_proxy)
            handed_on+=("$name=$value") ;;
    esac
done < <(env -0)

fail() {
    printf '\nfresh machine: FAILED: %s\n' "$1" >&2
    [ -z "${2:-}" ] || { echo "last lines of that call:" >&2; tail -n 40 "$2" >&2; }
    exit 1
}

# make demo SIZE=tiny in the clone; $1 is the file for what it prints. Sets wall_s.
demo() {
    local begin=$SECONDS
    (cd "$clone" && env -i HOME="$home" PATH=/usr/bin:/bin TMPDIR="$scratch/tmp" "${handed_on[@]}" \
        make demo SIZE=tiny) >"$1" 2>&1 || fail "make demo SIZE=tiny ended with an error" "$1"
    wall_s=$((SECONDS - begin))
}

# Checksums of all results. The record beside each output is among them: a rerun would renew its date.
results() { (cd "$clone/results/tiny" && find . -type f -print0 | sort -z | xargs -0 sha256sum); }

git clone --quiet --no-hardlinks "$repository" "$clone"
echo "date     $(date -u +%Y-%m-%dT%H:%M:%SZ)"
echo "commit   $(git -C "$clone" rev-parse HEAD)"
echo "system   $(uname -sm), $(getconf _NPROCESSORS_ONLN) cores"
names=("${handed_on[@]%%=*}")
echo "handed   HOME PATH TMPDIR ${names[*]:-}"

demo "$scratch/first.log"
echo "python   $("$clone/.venv/bin/python" --version)"
echo "first    $wall_s s with the set-up of .venv ($(du -sm "$clone/.venv" | cut -f1) MB)"
[ -s "$clone/results/tiny/summary.csv" ] || fail "the first call left no results/tiny/summary.csv" "$scratch/first.log"
results >"$scratch/first.sha256"

demo "$scratch/second.log"
echo "second   $wall_s s"
grep -q "Nothing to be done" "$scratch/second.log" ||
    fail "the second call did not say 'Nothing to be done'" "$scratch/second.log"
results >"$scratch/second.sha256"
cmp -s "$scratch/first.sha256" "$scratch/second.sha256" || fail "the second call changed results"

changed=$(git -C "$clone" status --porcelain)
[ -z "$changed" ] || fail "the clone is no longer clean: $changed"
echo "fresh machine: ok, $(wc -l <"$scratch/first.sha256") files in results/tiny"
