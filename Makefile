# Thalweg: the commands of the README. Each does the set-up that it needs.
SHELL := bash
SIZE ?= demo
CORES ?= $(shell nproc 2>/dev/null || sysctl -n hw.ncpu 2>/dev/null || echo 2)
PY := .venv/bin/python
SNAKEMAKE := .venv/bin/snakemake --cores $(CORES)

.PHONY: help env demo open pdf docs study record timings report real test check check-types check-rest test-slow test-cluster fuzz mutants golden numbers benchmark dist release-check lock clean

help: ## list the commands
	@awk -F':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

env: .venv/.complete ## make .venv from the lock file
.venv/.complete: envs/requirements.lock envs/make-venv.sh
	@envs/make-venv.sh

demo: env ## raw logs of the digital twin -> riverbank; SIZE=tiny|demo|full|mulde
	@PYTHONPATH=workflow/progress $(SNAKEMAKE) --logger thalweg --config campaign=$(SIZE)
	@$(PY) -m thalweg summary results/$(SIZE)

open: ## front page of the campaign SIZE in a browser
	@page="$(CURDIR)/results/$(SIZE)/index.html"; \
	if [ ! -e "$$page" ]; then echo "There is no $$page yet: make demo SIZE=$(SIZE)" >&2; exit 1; fi; \
	echo "Opening $$page"; \
	$(PY) -c 'import pathlib, sys, webbrowser; webbrowser.open(pathlib.Path(sys.argv[1]).as_uri())' "$$page" >/dev/null

report: env ## one self-contained page of the campaign SIZE
	@$(SNAKEMAKE) --config campaign=$(SIZE) --report results/$(SIZE)/report.html

pdf: env ## report of survey to hand in, of the campaign SIZE -> results/SIZE/report.pdf
	@$(SNAKEMAKE) --config campaign=$(SIZE) -- results/$(SIZE)/report.pdf
	@echo $(CURDIR)/results/$(SIZE)/report.pdf

docs: .venv/.docs ## site of the documentation -> results/site; nothing is fetched while it is built
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --quiet
	@echo "Open results/site/index.html; with search: $(PY) -m http.server -d results/site"
.venv/.docs: envs/docs.lock .venv/.complete
	@$(PY) -m pip --version >/dev/null 2>&1 && $(PY) -m pip install --quiet --require-hashes -r $< \
	    || python3 -m pip --python $(PY) install --quiet --require-hashes -r $<
	@touch $@

study: env ## one study of the twin and its record in docs/validation; NAME=consistency_study
	@$(SNAKEMAKE) $(NAME)
	@$(MAKE) --no-print-directory record

record: env ## tables of the last run of NAME (a study, field, basin, full) -> docs/validation, README
	@$(PY) docs/make_validation.py $(NAME)
	@$(PY) docs/make_pages.py

timings: env ## time and memory of a campaign in an empty folder -> docs/validation, README; SIZE=tiny
	@$(PY) docs/make_timings.py $(SIZE) --cores $(CORES)
	@$(PY) docs/make_pages.py

real: env ## every row of docs/validation/real.md on recordings of others (THALWEG_DATA); ONLY=word: rows with it
	@$(PY) docs/make_real.py --only "$(ONLY)" --workers $(CORES)

test: env ## static checks and the test suite, beside each other
	@$(MAKE) --no-print-directory check & \
	$(PY) -m pytest -n $$(( $(CORES) + 1 )) --dist loadgroup -m "not slow" --durations=60; \
	tests=$$?; wait $$! && exit $$tests

check: env ## static checks only
	@$(MAKE) --no-print-directory -j2 check-types check-rest

check-types:
	@$(PY) -m mypy

check-rest:
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@.venv/bin/snakefmt --check Snakefile workflow
	@envs/check-workflow.sh
	@$(PY) tests/counted.py

test-slow: env ## long studies
	@$(PY) -m pytest -m slow --benchmark-disable tests

test-cluster: env ## a campaign on a SLURM of its own, with forced faults (Debian: slurm-wlm, munge)
	@$(PY) tests/cluster/run --cpus $(CORES)

size: env ## tokens of code by package, beside those that docs/architecture.md states
	@$(PY) docs/make_size.py

fuzz: env ## readers of recordings and documents on 10,000 mutated inputs, example tables in other forms; SEED=number: other draws
	@THALWEG_FUZZ=10000 THALWEG_FUZZ_SEED=$(or $(SEED),0) $(PY) -m pytest -n $(CORES) -k fuzz tests/ingest tests/core

mutants: env ## 500 deliberate mistakes, other ones each time, that tests must find; SEED=number repeats a draw
	@$(PY) tests/mutants/run.py --workers $(CORES) $(if $(SEED),--seed $(SEED))

golden: env ## results of small campaigns beside those of another checkout, made by the same command there; BEFORE=folder
	@for each in tiny field_tiny basin_tiny; do $(SNAKEMAKE) --config campaign=$$each || exit; done
	@$(SNAKEMAKE) reproduce
	@bash tests/golden/commands.sh
	@[ -z "$(BEFORE)" ] || $(PY) tests/golden/compare.py $(BEFORE)/results results

numbers: env ## every number of small campaigns, which tests compare, written anew: after a change that moves results
	@$(PY) tests/golden/kept_numbers.py

benchmark: env ## speed against named peers
	@$(PY) -m pytest tests/benchmarks -m slow -s

dist: env ## sdist and wheel -> dist/, the same bytes twice, tried in empty environments
	@envs/make-dist.sh

release-check: env ## every record of docs/validation made again, with a table at the end; WITH="--profile profiles/slurm"
	@$(PY) docs/release_check.py --cores $(CORES) $(WITH)

lock: ## renew the lock file (needs uv)
	@envs/lock.sh

clean: ## remove results, logs and benchmarks; keeps .venv
	@rm -rf results/* logs benchmarks .snakemake
