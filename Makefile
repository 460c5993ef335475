# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
# make setup      virtual environment with everything that is needed to run
# make demo       run the demo; PLANT=pendulum (the default) or PLANT=robots
# make live       a page in the browser on simulated nodes; PLANT as for demo, or module:Class
# make test       run every test that a change must pass (TESTS=test/ros picks some of them)
# make nightly    run what takes longer: bad input, sabotaged solvers, faults of nodes, packages
# make lint       check style and types
# make docs       build the documentation's pages: docs/_build/index.html
# make benchmark  measure everything and write docs/benchmarks.md (half an hour); OPTIONS=--quick to try it
# make config     bring what is generated from the code up to date: parameter files, tables
# make clean      remove all that was made
# Each sets up what is missing. Needed: python3 >= 3.10 with venv. A sourced ROS 2 is used as it is;
# without one, the pinned ROS 2 Jazzy wheels go into the virtual environment. With
# CONSTRAINTS=constraints-noble.txt these are Ubuntu 24.04's versions instead of the newest.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV ?= .venv
PLANT ?= pendulum
CONSTRAINTS ?= constraints.txt
TESTS ?= test/unit test/ros test/system

# Two installations of ROS 2 must never meet in one process: the environment is made for one kind,
# and made anew when the kind, or the versions, change.
IMPORT_NATIVE_RCLPY := import importlib.util, sys, rclpy; \
  sys.exit(importlib.util.find_spec("ros_wheels_bootstrapper") is not None)
ROS := $(shell [ -n "$${AMENT_PREFIX_PATH:-}" ] \
  && $(PYTHON) -c '$(IMPORT_NATIVE_RCLPY)' 2>/dev/null && echo native || echo wheels)

ifeq ($(ROS),native)
  KIND := native
  VENV_OPTIONS := --system-site-packages
  PACKAGE := .[live,study]
  WHAT := this package, for the ROS 2 $(ROS_DISTRO) that is sourced
else
  KIND := wheels-$(basename $(notdir $(CONSTRAINTS)))
  PACKAGE := .[jazzy,live,study]
  WHAT := ROS 2 Jazzy wheels and this package (about 950 MB)
endif

BIN := $(VENV)/bin
READY := $(VENV)/.ready-$(KIND)
PINS := $(VENV)/pins.txt
# Compiling what is never imported takes half of the time.
PIP := $(BIN)/python -m pip install -qq --no-compile --disable-pip-version-check -c '$(PINS)'

.PHONY: help setup demo live test nightly lint docs benchmark config clean

help:
	@sed -n '3,15s/^# //p' Makefile

setup: $(READY)

setup-%: $(READY)-%
	@:

$(READY): constraints.txt $(CONSTRAINTS) setup.py
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.10 or newer is needed" if sys.version_info < (3, 10) else 0)'
	@echo '[1/3] virtual environment in $(VENV)'
	@if [ "$$(cat '$(VENV)/.kind' 2>/dev/null || echo '$(KIND)')" != '$(KIND)' ]; then rm -rf '$(VENV)'; fi
	@$(PYTHON) -m venv $(VENV_OPTIONS) '$(VENV)'
	@echo '$(KIND)' >'$(VENV)/.kind'
	@echo '[2/3] $(WHAT)'
ifeq ($(ROS),native)
	@$(BIN)/python -c 'import numpy; print(f"numpy=={numpy.__version__}")' >'$(PINS)'
else
	@awk -F== '/^#/ || (FNR < NR && tolower($$1) in pinned) { next } \
	  FNR == NR { pinned[tolower($$1)] } { print }' '$(CONSTRAINTS)' constraints.txt >'$(PINS)'
endif
	@$(PIP) -e '$(PACKAGE)' || { echo \
	  'The packages could not be installed (see above). ROS 2 wheels exist for Linux on x86-64 with' \
	  'Python 3.10 to 3.14 (tested: to 3.13); elsewhere install and source ROS 2 Jazzy, then try again.' >&2; exit 1; }
	@echo '[3/3] compiled kernels'
	@$(BIN)/python -m tdm_planner.set_up
	@touch '$@'
	@echo 'ready'

# What tests, linters, pages and benchmarks need besides; setup-test,dev takes both at once.
COMMA := ,
$(READY)-%: $(READY)
	@echo '[+] packages: $*'
	@$(PIP) -e '.[$*]'
	@touch $(patsubst %,'$(READY)-%',$(subst $(COMMA), ,$*))

demo: $(READY)
	@$(BIN)/tdm demo '$(PLANT)'

live: $(READY)
	@$(BIN)/tdm live '$(PLANT)'

# Tests with real processes come last, one at a time: each of them starts several.
test: PROCESSES = $(filter test/system%,$(TESTS))
test: OTHERS = $(filter-out test/system%,$(TESTS))
test: PARALLEL = --numprocesses auto --dist loadfile --max-worker-restart 0
test: $(READY)-test
	$(if $(OTHERS),@$(BIN)/python -m pytest $(PARALLEL) $(OTHERS))
	$(if $(PROCESSES),@$(BIN)/python -m pytest $(PROCESSES))

# What fuzzing finds is printed as JSON, to be kept in test/fuzz_corpus.json.
nightly: $(READY)-test
	@$(BIN)/python -m pytest -rP test/nightly

lint: $(READY)-test $(READY)-dev
	@echo 'ruff check' && $(BIN)/ruff check .
	@echo 'ruff format --check' && $(BIN)/ruff format --check .
	@echo 'flake8' && $(BIN)/flake8 .
	@if $(BIN)/python -c 'import numpy, sys; \
	    sys.exit([int(part) for part in numpy.__version__.split(".")[:2]] < [2, 3])'; \
	  then echo 'mypy --strict' && $(BIN)/mypy --strict; \
	  else echo 'mypy is skipped: NumPy older than 2.3 types arrays differently'; fi

# Warnings are errors, links that lead nowhere among them.
docs: $(READY)-docs
	@$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --fresh-env --quiet \
	  --doctree-dir docs/_build/.doctrees docs docs/_build

benchmark: $(READY)-test
	@$(BIN)/python -m benchmark --docs $(OPTIONS)

# Parameter files, tables and pictures of the documentation, from the code.
config: $(READY)
	@$(BIN)/python -m tools.generate

clean:
	rm -rf '$(VENV)' .venv-* build install log docs/_build *.egg-info
