# Every target works from a fresh clone with Python 3.11+ and make, offline after its first run, and from a path with
# spaces (so: relative paths only). `make help` lists the targets.

VENV := .venv
BIN := $(VENV)/bin
PYTHON := $(BIN)/python
# The first interpreter of 3.11 or later; override with `make PYTHON3=...`.
PYTHON3 ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
UV := UV_PYTHON_DOWNLOADS=never UV_NO_CONFIG=1 $(BIN)/uv
INSTALL := $(UV) pip install --quiet --python $(PYTHON) --compile-bytecode --require-hashes
SELF := $(UV) pip install --quiet --python $(PYTHON) --no-deps --no-build-isolation --offline --editable .
PYTEST := $(PYTHON) -m pytest

.DEFAULT_GOAL := help
.PHONY: help demo test check seed mini mini-check bench-error bench-service bench-jobs bench-rays stress mutants lock warm clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 16

$(VENV)/uv.stamp: requirements-uv.lock
	@test -n "$(PYTHON3)" || { echo "Smalti needs Python 3.11 or later on the PATH (or: make PYTHON3=/path/to/python)"; exit 2; }
	@echo "Building $(VENV) with $(PYTHON3)"
	@test -x $(PYTHON) || $(PYTHON3) -m venv $(VENV)
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-uv.lock
	@touch $@

$(VENV)/run.stamp: requirements.lock pyproject.toml $(VENV)/uv.stamp
	@echo "Installing the locked requirements"
	@$(INSTALL) -r requirements.lock
	@$(SELF)
	@touch $@

$(VENV)/dev.stamp: requirements-dev.lock $(VENV)/run.stamp
	@echo "Installing the locked development requirements"
	@$(INSTALL) -r requirements-dev.lock
	@touch $@

demo: $(VENV)/run.stamp ## start the service, render scenes/demo.json over HTTP into out/, shut down
	@$(PYTHON) -m client demo

test: $(VENV)/dev.stamp ## run all tests
	@$(PYTHON) -m client warm
	$(PYTEST)

check: $(VENV)/dev.stamp ## linter, formatter, strict types, import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

seed: $(VENV)/dev.stamp ## render the nine seed images and compare them with the oracle and the references
	@$(PYTHON) -m benchmarks.seed

mini: $(VENV)/dev.stamp ## render the MINI, 3840 x 2160, 16 samples, through HTTP and the worker pool
	@$(PYTHON) -m benchmarks.mini

mini-check: $(VENV)/dev.stamp ## compare the MINI's picture with the oracle: leaks, acne, noise; two minutes
	@$(PYTHON) -m client warm
	@$(PYTHON) -m benchmarks.mini_check

bench-error: $(VENV)/dev.stamp ## error against seconds, by sampler
	@$(PYTHON) -m benchmarks.error

bench-service: $(VENV)/dev.stamp ## what the service costs beside the kernels
	@$(PYTHON) -m benchmarks.service

bench-jobs: $(VENV)/dev.stamp ## whole pictures, starts and growth; beside Mitsuba where SMALTI_MITSUBA_PYTHON names one
	@$(PYTHON) -m benchmarks.jobs

bench-rays: $(VENV)/dev.stamp ## rays and builds beside Embree; SMALTI_EMBREE names a folder with embreex if it is not installed
	@$(PYTHON) -m benchmarks.rays

stress: $(VENV)/dev.stamp ## the numerical stress suite at full size, a row a test
	@$(PYTHON) -m tests.numerics

mutants: $(VENV)/dev.stamp ## break the numerics in a copy, and see that the stress suite notices
	@$(PYTHON) -m tests.numerics.mutants

warm: $(VENV)/run.stamp ## compile the kernels into the cache
	@$(PYTHON) -m client warm

lock: $(VENV)/uv.stamp ## resolve the requirements anew
	@$(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --upgrade --extra source \
		--custom-compile-command "make lock" pyproject.toml -o requirements.lock
	@$(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --upgrade --extra source --extra dev \
		--custom-compile-command "make lock" -c requirements.lock pyproject.toml -o requirements-dev.lock

clean: ## remove what the targets made, the environment included
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
