# Each target does all set-up it needs, in .venv. `PYTHON=/path/to/python3.12 make setup` chooses the interpreter.
# Where rendering or the browser for one test needs packages of the system, they are named and then installed if this user
# may; `NO_SYSTEM=1 make ...` installs none and says what to install.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup pictures test quick lerobot nightly check format docs release bench demo clean
export NO_SYSTEM

BIN := .venv/bin
# Processes of the test runner: one more than cores, for tests that wait. With a simulator each takes about 2 GB.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n > 4 ? 4 : n + 1)))
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

help:  ## this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/make \1\t\2/' | expand -t 16

setup: .venv/.simulates  ## create .venv and install everything

pictures: .venv/.renders  ## see to a Vulkan device, for pictures; clouds do without

# Several stamps: a machine that only lacks Vulkan does not install Python packages again.
.venv/.installed: pyproject.toml constraints.txt scripts/setup_python.sh
	bash scripts/setup_python.sh
	@touch $@

.venv/.simulates: .venv/.installed scripts/setup_vulkan.sh
	bash scripts/setup_vulkan.sh libraries
	@touch $@

.venv/.renders: .venv/.simulates
	bash scripts/setup_vulkan.sh
	@touch $@

# For one test; `make setup` alone does without.
.venv/.browser: .venv/.installed scripts/setup_browser.sh
	bash scripts/setup_browser.sh

test: pictures  ## all tests but the nightly ones: under ten minutes on two cores
	$(PYTEST) -m "not nightly"

# Laws that need no process, no simulator and no dataset.
QUICK := tests/test_architecture.py tests/test_fingerprint.py tests/contract tests/evaluation tests/experts tests/mechanisms
quick: check  ## format, lint, types, layers, and laws that need no process: under 90 seconds
	$(PYTEST) -m "not nightly and not sim" $(wildcard $(QUICK))

LEROBOT ?= main
lerobot: .venv/.installed  ## tests without the simulator against another LeRobot: `make lerobot LEROBOT=main`, or a release
	JOBS=$(JOBS) bash scripts/test_lerobot.sh "$(LEROBOT)"

nightly: pictures .venv/.browser  ## what takes long: long tests, every expert, hidden states, robustness; an hour or more
	bash scripts/nightly.sh

check: .venv/.installed  ## format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: .venv/.installed  ## rewrite the files as `make check` wants them
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: .venv/.installed  ## the documentation as a site, in outputs/site
	$(BIN)/python -m mkdocs build --strict

# What the workflow of a release does, up to the upload, on the packages of .venv instead of downloaded ones.
release: .venv/.simulates  ## wheel and source archive in dist/, tried in an environment of their own
	rm -rf dist
	$(BIN)/python -m build --no-isolation --outdir dist
	$(BIN)/python scripts/smoke_test_release.py dist --share-packages

AGAINST ?= 13a4740
bench: pictures  ## measure speed, then compare with an older revision: `make bench AGAINST=HEAD~10`
	$(BIN)/adamanip bench
	$(BIN)/adamanip bench --against $(AGAINST)

demo: setup  ## collect, train and evaluate on a few safes
	bash scripts/demo.sh

clean:  ## remove .venv, caches and builds; outputs/ stays
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
