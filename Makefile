# Each target sets up what it needs in .venv. `PYTHON=/path/to/python3.12 make setup` chooses the interpreter.
# Rendering, and the browser of one nightly test, may need system packages: they are named, then installed if this user has
# the right to. `NO_SYSTEM=1 make ...` installs none and prints what to install.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup pictures test quick quick-tests lerobot nightly check format docs release bench publish demo clean
export NO_SYSTEM

BIN := .venv/bin
# Processes of the test runner: one more than cores, for tests that wait. With a simulator each takes about 2 GB.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n > 4 ? 4 : n + 1)))
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

help:  ## print this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/make \1\t\2/' | expand -t 16

setup: .venv/.simulates  ## create .venv and install everything

pictures: .venv/.renders  ## set up a Vulkan device, for images; clouds need none

# Several stamp files: a machine that only lacks Vulkan does not install the Python packages again.
.venv/.installed: pyproject.toml constraints.txt scripts/setup_python.sh
	bash scripts/setup_python.sh
	@touch $@

.venv/.simulates: .venv/.installed scripts/setup_vulkan.sh
	bash scripts/setup_vulkan.sh libraries
	@touch $@

.venv/.renders: .venv/.simulates
	bash scripts/setup_vulkan.sh
	@touch $@

# For one nightly test; `make setup` does not install it.
.venv/.browser: .venv/.installed scripts/setup_browser.sh
	bash scripts/setup_browser.sh

test: pictures  ## all tests but the nightly ones: under ten minutes on two cores
	$(PYTEST) -m "not nightly"

# Laws that need no process, no simulator and no dataset.
QUICK := tests/test_architecture.py tests/test_golden.py tests/test_schema.py tests/test_seeds.py tests/test_rotations.py \
	tests/test_pointcloud.py tests/test_versions.py tests/evaluation tests/experts tests/mechanisms
quick: .venv/.installed  ## format, lint, types, layers, and laws that need no process: under 90 seconds
	$(MAKE) --no-print-directory -j2 check quick-tests

quick-tests: .venv/.installed
	$(PYTEST) -m "not nightly and not sim" $(QUICK)

LEROBOT ?= main
lerobot: .venv/.installed  ## tests without the simulator against another LeRobot: `make lerobot LEROBOT=main`, or a release
	JOBS=$(JOBS) bash scripts/test_lerobot.sh "$(LEROBOT)"

nightly: pictures .venv/.browser  ## long forms of tests, every expert, hidden states, robustness: about an hour on two cores
	bash scripts/nightly.sh

check: .venv/.installed  ## format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: .venv/.installed  ## format the files and fix what ruff can fix
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: .venv/.installed  ## build the documentation site in outputs/site
	$(BIN)/python -m mkdocs build --strict

# As the release workflow up to the upload, with the packages of .venv instead of downloaded ones.
release: .venv/.simulates  ## build wheel and source archive in dist/, test them in a new environment
	rm -rf dist
	$(BIN)/python -m build --no-isolation --outdir dist
	$(BIN)/python scripts/smoke_test_release.py dist --share-packages

bench: pictures  ## measure speed on this machine
	$(BIN)/python scripts/bench.py

publish: .venv/.simulates  ## publish nine policies, their data and the environments: make publish USER=you [ARGS=--dry-run]
	$(if $(filter command,$(origin USER)),,$(error the user of the Hub is missing: make publish USER=you))
	$(BIN)/python scripts/publish.py --user "$(USER)" $(ARGS)

demo: setup  ## collect, train and evaluate on a few safes
	bash scripts/demo.sh

clean:  ## remove .venv, caches and builds; outputs/ stays
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
