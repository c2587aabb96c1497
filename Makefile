# Each target makes the virtual environment it needs: nothing but Python 3.11, make and a C library is required.
PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# Tests on all cores, neighbours on one: they share what is slow to make.
PARALLEL := -n auto --dist worksteal

# Python keeps its compiled modules, also where that is switched off: the tests start many programs.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: setup fold test quick lint compile hil docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "foldcell needs Python 3.11 ('$(PYTHON)' was not found); set PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

fold: setup            ## one-shot fold of a medium towel in the simulated cell
	$(BIN)/foldcell fold medium_towel

test: setup            ## lint, types, layers and the whole test suite
	$(MAKE) --jobs=2 lint compile
	$(BIN)/python -m pytest $(PARALLEL)

quick: setup           ## the tests that take a minute together: no whole runs, and nothing marked long
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not long"

lint: setup
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/lint-imports && $(BIN)/mypy

compile: setup         ## the cloth simulation, once, instead of in each process that tests it
	$(BIN)/foldcell optimise small_towel

hil: setup             ## the scripted runs of tests/hil in the simulated cell
	$(BIN)/foldcell hil tests/hil

# the viewer is drawn without a screen, but not without a graphics driver: on Debian mesa-vulkan-drivers
docs: setup            ## the pictures of README and docs, from three runs (needs a graphics driver)
	$(BIN)/python -m benchmarks.pictures
	$(BIN)/python -m benchmarks.film

clean:
	rm -rf $(VENV) build *.egg-info
