# Each target makes the virtual environment it needs: nothing but make, a C library, and Python 3.11 or uv is required.
PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
# uv installs several times faster than pip: the user's own, or this version, installed into the environment.
UV_VERSION := 0.13.9
UV     = $(shell command -v uv || echo $(BIN)/uv)
# One worker more than cores (tests/conftest.py), neighbours on one: they share what is slow to make.
PARALLEL := -n auto --dist worksteal

# Python keeps its compiled modules, also where that is switched off: the tests start many programs.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: setup setup-dev fold test quick lint compile modules hil docs site lock release clean

setup: $(VENV)/.installed          ## what a run needs
setup-dev: $(VENV)/.installed-dev  ## and what the tests need

$(BIN)/python:
	@if command -v $(PYTHON) >/dev/null; then $(PYTHON) -m venv $(VENV); \
	elif command -v uv >/dev/null; then uv venv --quiet --seed --python 3.11 $(VENV); \
	else echo "foldcell needs Python 3.11 ('$(PYTHON)' was not found): set PYTHON=/path/to/python3.11, or install uv, which brings it"; exit 1; fi
	@command -v uv >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check uv==$(UV_VERSION) || \
	echo "uv cannot be installed: pip installs the same versions, which takes longer"

# installs the package with the extras $(1). pip takes no hashes beside an editable package, so it gets the pins alone
define install
@if test -x "$(UV)"; then "$(UV)" pip install --python $(BIN)/python -c constraints.txt -e ".$(1)"; \
else sed -n 's/^\([^ #]*==[^ ]*\).*/\1/p' constraints.txt > $(VENV)/pins.txt && \
$(BIN)/python -m pip install --disable-pip-version-check -c $(VENV)/pins.txt -e ".$(1)"; fi
@touch $@
endef

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
	$(call install,)

$(VENV)/.installed-dev: $(VENV)/.installed
	$(call install,[dev])

$(VENV)/.installed-docs: $(VENV)/.installed
	$(call install,[docs])

fold: setup            ## one-shot fold of a medium towel in the simulated cell
	$(BIN)/foldcell fold medium_towel

test: setup-dev        ## lint, types, layers and the whole test suite
	$(MAKE) --jobs=2 lint compile modules
	$(BIN)/python -m pytest $(PARALLEL)

quick: setup-dev       ## the tests that take 80 s of processor time together: no whole runs, and nothing marked long
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not long"

lint: setup-dev
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/lint-imports && $(BIN)/mypy

compile: setup         ## the cloth simulation, once, instead of in each process that tests it
	$(BIN)/foldcell optimise small_towel

modules: setup-dev     ## Python's compiled modules of the tests, once, instead of in each process that runs them
	-$(BIN)/python -m pytest --collect-only -qq > /dev/null  # what cannot be collected is told by the run itself

hil: setup             ## the scripted runs of tests/hil in the simulated cell
	$(BIN)/foldcell hil tests/hil tests/hil/faults

# the viewer is drawn without a screen, but not without a graphics driver: on Debian mesa-vulkan-drivers
docs: setup            ## the pictures of README and docs, from runs (needs a graphics driver)
	$(BIN)/python -m benchmarks.pictures
	$(BIN)/python -m benchmarks.film

site: $(VENV)/.installed-docs  ## build/site/index.html: the pages of docs, with search; opens without a network
	$(BIN)/zensical build --clean --strict

lock: setup            ## pins of all packages, with the hashes of their files; no address of an index
	$(UV) pip compile pyproject.toml --all-extras -c constraints.txt --generate-hashes --no-emit-index-url \
	    --no-header --no-annotate --python-version 3.11 --python-platform x86_64-manylinux_2_28 --quiet -o constraints.txt

release: setup-dev     ## is this commit a release? version, tag, changelog, licences, figures; a towel folded from the wheel
	$(BIN)/python -m benchmarks.release

clean:
	rm -rf $(VENV) build *.egg-info
