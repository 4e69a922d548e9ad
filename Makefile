# One environment, pinned by constraints.txt; every target sets it up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete

# pip leaves compiling Python files to their first import, which must then be kept
unexport PYTHONDONTWRITEBYTECODE

help:
	@echo "make demo    install, evaluate three policies and a schedule file, write output/demo/report.html"
	@echo "make test    install, lint, types and tests"
	@echo "make docs    build these pages as a site in output/docs"
	@echo "make clean   remove environments, output and compiled kernels"
	@echo "others, for developers: docs/commands.md"

.PHONY: help setup demo test test-slow test-haswell test-bounds test-processors quick lint types kernels test-pythons test-ray test-libraries test-lowest test-zoo browser test-app docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a few minutes the first time"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[agents,dev,docs]'
	touch $(STAMP)

demo: setup
	$(BIN)/probe-env evaluate constant slow-down pi configs/schedules/example.csv --limit 6 --output output/demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

kernels: setup
	$(BIN)/python -m probe_env.compile_kernels

# two test processes on two cores: threads of linear algebra would wait for each other
test test-slow test-haswell test-bounds test-processors test-libraries test-lowest test-zoo quick: export OPENBLAS_NUM_THREADS = 1
test test-slow test-haswell test-bounds test-processors test-libraries test-lowest test-zoo quick: export OMP_NUM_THREADS = 1
PYTEST := $(BIN)/pytest --numprocesses 2 --dist worksteal

# make test TESTS=tests/envs runs a part
TESTS ?= tests
test: setup
	$(MAKE) --jobs=2 --output-sync=target lint types kernels
	$(PYTEST) -m "not slow" $(TESTS)

# what takes long: the wheel, the site, training, real kills, ensembles; then, side by side, bounds checks, the quicker
# statistics as another processor rounds them (test-processors: all, more processors, other seeds), other libraries and versions
test-slow: setup kernels
	$(PYTEST) -m slow $(TESTS)
	$(MAKE) --jobs=2 --output-sync=target test-haswell test-bounds test-libraries test-lowest test-zoo

test-haswell: setup
	$(BIN)/python tests/processors.py --only haswell -m "processor and not slow"

test-bounds: setup
	$(BIN)/pytest tests/physics/test_bounds.py

test-processors: setup kernels
	$(BIN)/python tests/processors.py --numprocesses 2 --dist worksteal

# lint, types of the changed files, and the tests of their rooms; BASE is what they are compared with
BASE ?= HEAD
CHANGED = $(shell git diff --name-only --diff-filter=d $(BASE) -- '*.py'; git ls-files --others --exclude-standard -- '*.py')
ROOMS = $(wildcard $(sort $(shell echo $(CHANGED) | tr ' ' '\n' | sed -nE 's#^(probe_env|agents/probe_agents|tests)/([a-z_]+)/.*#tests/\2#p; s#^probe_env/[a-z_]+\.py#tests/settings#p')))
quick: setup
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(if $(filter probe_env/% agents/%,$(CHANGED)),$(BIN)/mypy $(filter probe_env/% agents/%,$(CHANGED)))
	$(if $(ROOMS),$(PYTEST) -m "not slow" $(ROOMS),@echo "no tests of changed rooms")

# other versions of Python; tests that need torch or an agent library are skipped there
PYTHONS ?= 3.12 3.13 3.14
PYTHON3.12 ?= python3.12
PYTHON3.13 ?= python3.13
PYTHON3.14 ?= python3.14
WITHOUT_TORCH := cmaes charset-normalizer corner emcee moocore optuna pint python-calamine
test-pythons: $(PYTHONS:%=test-python-%)

test-python-%:
	test -x .venv-$*/bin/python || $(PYTHON$*) -m venv .venv-$*
	.venv-$*/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]' $(WITHOUT_TORCH)
	.venv-$*/bin/python -m probe_env.compile_kernels
	.venv-$*/bin/pytest --numprocesses 2 --dist worksteal -ra

# environments of their own, pinned by tests/NAME/constraints.txt: RLlib, other libraries, the lowest versions, RL Zoo
APART := ray libraries lowest zoo
NEEDS_ray := '.[agents,dev,ray]'
NEEDS_libraries := . pytest 'minari[create,hdf5]' skrl tianshou torchrl
NEEDS_zoo := '.[agents]' pytest rl_zoo3
NEEDS_lowest := '.[agents,app,commands,plant]' pytest
# numba keeps the kernels of one of its versions
test-lowest: export NUMBA_CACHE_DIR = $(CURDIR)/.venv-lowest/kernels
$(APART:%=test-%): test-%:
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	.venv-$*/bin/pip install --quiet --no-compile --disable-pip-version-check --constraint tests/$*/constraints.txt --editable $(NEEDS_$*)
	.venv-$*/bin/pytest -W default --disable-warnings tests/$*

# the app in a real browser: Debian's Chromium, driven by Playwright, which neither the app nor make test needs
CHROMIUM ?= /usr/bin/chromium
PICTURES ?= output/app-pictures
browser: setup
	test -x $(CHROMIUM) || { echo "installing Debian's chromium, which takes root (or name one that you have: make test-app CHROMIUM=PATH)"; \
		apt-get update && apt-get install --yes --no-install-recommends chromium; }
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[browser]'

test-app: browser
	PROBE_ENV_CHROMIUM=$(CHROMIUM) PROBE_ENV_PICTURES=$(PICTURES) $(BIN)/pytest tests/browser

# the site, with warnings such as broken links as errors, and its tests
SITE := output/docs
docs: setup
	rm -rf $(SITE)
	$(BIN)/python -m sphinx -q -W --keep-going --doctree-dir output/doctrees --fresh-env docs $(SITE)
	PROBE_ENV_SITE=$(SITE) $(BIN)/pytest tests/docs
	@echo "open $(CURDIR)/$(SITE)/index.html"

clean:
	rm -rf $(VENV) $(APART:%=.venv-%) $(PYTHONS:%=.venv-%) output
	find probe_env agents -name __pycache__ -prune -exec rm -rf {} +
