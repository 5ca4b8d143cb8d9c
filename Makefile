# Each target does all of its own set-up and then its job: a .venv from Python 3.11 or later, at the pinned versions.
SHELL := /bin/bash
.DEFAULT_GOAL := help
VENV := .venv
PY := $(VENV)/bin/python
READY := $(VENV)/.ready
FIND_PYTHON = for p in $(PYTHON) python3.11 python3.12 python3.13 python3.14 python3; do \
  "$$p" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { command -v "$$p"; break; }; done

.PHONY: help fuzz setup rehearse test test-fast docs lint study blind bench campaign faults firmware-test reproduce plan-library bench-peers lock clean

help:  ## what can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

$(READY): pyproject.toml constraints.txt
	@python="$$($(FIND_PYTHON))"; \
	  if [ -z "$$python" ]; then echo "Python 3.11 or later with venv is needed; install it, or: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)" >&2; exit 1; fi; \
	  [ -x $(PY) ] && $(PY) -m pip --version >/dev/null 2>&1 || "$$python" -m venv --clear $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@# A first flight compiles what numba compiles, so that the next one starts at once.
	@$(VENV)/bin/groundstation rehearse --scenario clean --logs $(VENV)/first-flight >/dev/null 2>$(VENV)/first-flight.log || \
	  { tail -n 5 $(VENV)/first-flight.log; echo "the first flight failed; going on" >&2; }
	@touch $@

setup: $(READY)  ## the virtual environment alone

rehearse: $(READY)  ## a whole flight in simulation, from plan to report
	@$(VENV)/bin/groundstation rehearse $(ARGS)

test-fast: $(READY)  ## the tests without processes, terminals, browsers and long flights: under a minute
	@$(PY) -m pytest -q -n 2 -m "not slow" $(ARGS)

docs: $(READY)  ## the documentation site in build/site; any warning is an error
	@$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict --quiet $(ARGS)

test: $(READY)  ## the whole test suite
	@$(PY) -m pytest -n 2 --reruns 1 -raR $(ARGS)

lint: $(READY)  ## format, lint, types, import rules
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/pyright
	$(VENV)/bin/lint-imports

study: $(READY)  ## many simulated flights: accuracy, coverage, scatter against the bound
	@$(PY) -m benchmarks.study
	@$(PY) -m benchmarks.scatter
	@$(PY) -m benchmarks.coverage

blind: $(READY)  ## diagnosis of effects it was not told about
	@$(PY) -m benchmarks.blind $(ARGS)

bench: $(READY)  ## speed of planner, simulator, estimators, recorder, log readers, catalogue, start-up; evenness of setpoints; ten minutes of full load
	@for each in startup simulator planner estimators recorder logs setpoint_jitter catalogue full_load; do OMP_NUM_THREADS=1 $(PY) -m benchmarks.$$each || exit; done

bench-peers: $(READY)  ## speed beside other tools, which it installs: docs/results/speed.md
	@$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,peers]'
	@$(PY) -m benchmarks.speed starts peers

plan-library: $(READY)  ## the solved rooms that plans start from, made anew
	@$(PY) -m benchmarks.plan_library $(ARGS)

campaign: $(READY)  ## flight after flight in simulation until three hidden effects are found and the targets are met
	@$(VENV)/bin/groundstation campaign --vehicle qball2-commanded --scenario hidden $(ARGS)

faults: $(READY)  ## every fault of line, process and sender through a relay, and how soon it is safe
	@$(PY) -m benchmarks.faults $(ARGS)

firmware-test: $(READY)  ## real ArduCopter and PX4 on our physics: ARDUCOPTER=path PX4=path
	@ARDUCOPTER=$(ARDUCOPTER) PX4=$(PX4) $(PY) -m pytest -rs tests/test_firmware_real.py $(ARGS)

reproduce: $(READY)  ## the paper's tables beside ours
	@$(VENV)/bin/groundstation reproduce $(ARGS)

fuzz: $(READY)  ## mutated inputs over every reader: ARGS='--minutes 60', '--count 1000000'
	@$(PY) -m benchmarks.fuzz $(ARGS)

lock: $(READY)  ## requirements.lock: the packages of constraints.txt with the hashes of their files
	@work=$$(mktemp -d) && trap 'rm -rf "$$work"' EXIT && $(PY) -m venv "$$work" && \
	  "$$work/bin/python" -m pip install --quiet --disable-pip-version-check uv==0.13.9 && \
	  "$$work/bin/uv" pip compile pyproject.toml --quiet --universal --python-version 3.11 --generate-hashes --extra dev \
	    --constraint constraints.txt --no-emit-index-url --no-header --no-annotate --output-file requirements.lock >/dev/null

clean:  ## remove the virtual environment and caches, never a flight
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis dist build
