# Each target does all set-up it needs, in .venv. `PYTHON=/path/to/python3.12 make setup` chooses the interpreter.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup test check format bench demo clean

BIN := .venv/bin
# Processes of the test runner; each simulator process takes about 2 GB.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n > 4 ? 4 : n)))
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile

help:  ## this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/make \1\t\2/' | expand -t 16

setup: .venv/.renders  ## create .venv, install everything, see to a Vulkan device

# Two stamps: a machine that only lacks Vulkan does not install Python packages again.
.venv/.installed: pyproject.toml constraints.txt scripts/setup_python.sh
	bash scripts/setup_python.sh
	@touch $@

.venv/.renders: .venv/.installed scripts/setup_vulkan.sh
	bash scripts/setup_vulkan.sh
	@touch $@

# For one test; `make setup` alone does without.
.venv/.browser: .venv/.installed scripts/setup_browser.sh
	bash scripts/setup_browser.sh

test: setup .venv/.browser  ## all tests: first those without a simulator, then those with it
	@status=0; \
	echo "== tests without the simulator"; $(PYTEST) -m "not sim" || status=$$?; \
	echo "== tests with the simulator"; $(PYTEST) -m sim || status=$$?; \
	exit $$status

check: .venv/.installed  ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: .venv/.installed  ## rewrite the files as `make check` wants them
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: setup  ## measure: collection, simulator, observation, training, action; prints JSON
	$(BIN)/adamanip bench

demo: setup  ## collect, train and evaluate on a few safes
	bash scripts/demo.sh

clean:  ## remove .venv, caches and builds; outputs/ stays
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
