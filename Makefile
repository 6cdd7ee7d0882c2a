# The two commands of the README, and what developers use.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
JOBS   ?= auto# processes that run tests: tests/workers.py

KORD_SOURCES := $(shell find bridges/kord -type f -not -name '*.pyc' -not -path '*/build/*' 2>/dev/null)

.PHONY: help docs demo test quick prove hunt mutants check format bench soak ros2 kord clean

help:   ## this list
	@sed -n 's/^\([a-z0-9]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 10

demo: $(VENV)/.installed   ## run the main job once and print the report
	@$(BIN)/station demo

PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder# the order of tests/tiers.py: those that wait come first

test: $(VENV)/.installed-test $(VENV)/.installed-kord $(VENV)/.collected   ## the test suite, without proofs
	@$(PYTEST) -m "not proof" --changed-builds

quick: $(VENV)/.installed-test   ## only the tests that start no process
	@$(BIN)/python -m pytest -n logical --dist worksteal -m unit

prove: $(VENV)/.installed-test $(VENV)/.installed-kord   ## promises in milliseconds, on a quiet machine; writes their figures into docs/
	@$(BIN)/python -m pytest -m proof --write-figures

N ?= 20
hunt: $(VENV)/.installed-test $(VENV)/.installed-kord   ## station tests N times on a loaded machine; lists what fails
	@$(BIN)/python -m tests.hunt --runs $(N)

check: $(VENV)/.installed-test   ## formatting, lint, types, which part imports which
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(VENV)/.installed-test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/.installed-test   ## measure, and write docs/performance.md's table
	$(BIN)/python -m benchmarks --write

docs: $(VENV)/.installed-docs   ## the docs as a site, into site/
	@$(BIN)/python -m sphinx -q -b html -W --keep-going -d build/site docs site
	@echo "site/index.html"

MINUTES ?= 60
soak: $(VENV)/.installed-test   ## break a whole station for an hour, under load; prints figures as JSON
	$(BIN)/python -m tests.faults.soak --minutes $(MINUTES)

mutants: $(VENV)/.installed-test $(VENV)/.installed-kord   ## small wrong patches of the product, each of which a test must notice
	$(BIN)/python -m tests.mutants --jobs 2

ros2: $(VENV)/.installed-ros2   ## ROS 2 for the tests of its bridge, in an environment of its own

kord: $(VENV)/.installed-kord   ## the bridge to a Kassow controller, with a simulated one; needs a C++ compiler

clean:   ## remove the environment and caches
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0] + "; name another with make PYTHON=...") if sys.version_info < (3, 11) else None'
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	@echo "Installing into $(VENV); this takes about a minute …"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[console]'
	@touch $@

# A pinned torch: a looser pin can pull gigabytes of CUDA that no test uses. Of its files few are ever imported, and those
# are compiled then: to compile all takes half of an installation.
$(VENV)/.installed-test: $(VENV)/.installed pyproject.toml
	@echo "Installing what the tests need; this takes a few minutes …"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile torch==2.13.0 --editable '.[test,torch,train]'
	@touch $@

# Imports all tests, so that what Python compiles of them is there: else each process of a first run compiles it. Twice,
# with sets in two orders: processes that run tests together must give them the same names in the same order.
$(VENV)/.collected: $(VENV)/.installed-test
	@echo "Importing all tests; this takes a minute …"
	@for seed in 1 2; do \
	  PYTHONHASHSEED=$$seed $(BIN)/python -m pytest --collect-only -q >$(VENV)/collected.log || { cat $(VENV)/collected.log; exit 1; }; \
	  grep :: $(VENV)/collected.log >$(VENV)/tests-$$seed.txt; done
	@diff $(VENV)/tests-1.txt $(VENV)/tests-2.txt || { echo "These tests are named or ordered by a set: sort it"; exit 1; }
	@touch $@

# ROS 2 as wheels of others (github.com/ycheng517/ros-python-wheels), for the tests of its bridge: an environment of its own,
# since they start every Python of theirs anew with other library paths. 260 MB; `make test` skips those tests without it.
$(VENV)/.installed-ros2: $(VENV)/bin/python Makefile
	@echo "Installing ROS 2 for the tests of its bridge …"
	@$(PYTHON) -m venv $(VENV)/ros2
	@$(VENV)/ros2/bin/python -m pip install --quiet --disable-pip-version-check --no-compile \
	  $(addprefix ros-kilted-,rclpy std-msgs geometry-msgs sensor-msgs diagnostic-msgs rosgraph-msgs rmw-fastrtps-cpp rmw-implementation) ros-std-srvs
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed pyproject.toml
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

# Only who drives a Kassow arm needs a compiler; without one the tests of its bridge are skipped, and say so.
$(VENV)/.installed-kord: $(VENV)/.installed $(KORD_SOURCES)
	@if command -v c++ >/dev/null; then \
	  echo "Building the bridge to Kassow's controller; this takes a minute …"; \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check ./bridges/kord; \
	else echo "No C++ compiler: the bridge to Kassow's controller is not built, and its tests are skipped"; fi
	@touch $@
