# TurtleBag. `make demo` and `make test` need nothing set up before: both build .venv themselves.
WORLD ?= turtlebot3_world
SEED ?= 1
TELEOP ?= tour
TASK ?= patrol

PYTHON ?= python3
PY := .venv/bin/python
TURTLEBAG := .venv/bin/turtlebag
READY := .venv/.ready

.DEFAULT_GOAL := help
.PHONY: help setup lint test clean
.DELETE_ON_ERROR:

help: ## list the targets
	@grep -hE '^[a-z][a-z _-]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 28

setup: $(READY) ## make the virtual environment (demo and test do it themselves)

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))' 2>/dev/null \
	  || { echo "make: needs Python 3.10 or newer with venv (on Debian: apt install python3-venv); or PYTHON=/path/to/python3 make ..." >&2; exit 2; }
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

lint: $(READY) ## ruff and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

test: lint ## lint, then pytest
	$(PY) -m pytest -n 2

clean: ## remove everything made here, the virtual environment too
	rm -rf data .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
