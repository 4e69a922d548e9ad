# One environment, pinned by constraints.txt; every target sets it up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete

# pip leaves compiling Python files to their first import, which must then be kept
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test test-processors test-pythons test-bounds browser test-app time-app lint types kernels results study bench timelapse stability chart peers scaling policies train train-smoke evaluation designs tradeoff fidelity test-ray readme docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a few minutes the first time"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[agents,dev,docs]'
	touch $(STAMP)

demo: setup
	$(BIN)/probe-env evaluate constant slow-down pi configs/schedules/example.csv --limit 6 --fidelity fast --output output/demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

kernels: setup
	$(BIN)/python -m probe_env.compile_kernels

PYTHONS ?= 3.12 3.13

# two processes on two cores: threads of linear algebra would wait for each other
test test-processors $(PYTHONS:%=test-python-%): export OPENBLAS_NUM_THREADS = 1
test test-processors $(PYTHONS:%=test-python-%): export OMP_NUM_THREADS = 1

test: setup
	$(MAKE) --jobs=2 --output-sync=target lint types kernels
	$(BIN)/pytest --numprocesses 2 --dist worksteal

# the statistics as other processors round them, and with other seeds
test-processors: setup
	$(BIN)/python tests/processors.py --numprocesses 2 --dist worksteal

# every kernel, compiled anew with bounds checks
test-bounds: setup
	$(BIN)/pytest tests/physics/test_bounds.py

# torch has no wheel for processors alone on every index, and is not needed by the physics and the environments: tests
# that need it or an agent library are skipped there, and the run says so
PYTHON3.12 ?= python3.12
PYTHON3.13 ?= python3.13
WITHOUT_TORCH := cmaes corner emcee moocore openpyxl optuna pint
test-pythons: $(PYTHONS:%=test-python-%)

test-python-%:
	test -x .venv-$*/bin/python || $(PYTHON$*) -m venv .venv-$*
	.venv-$*/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]' $(WITHOUT_TORCH)
	.venv-$*/bin/python -m probe_env.compile_kernels
	.venv-$*/bin/pytest --numprocesses 2 --dist worksteal -ra

# Everything published, again, where it is stale; `make results` says first what and how long. STAGES narrows it down.
results: setup
	$(BIN)/probe-env results $(STAGES)
	$(BIN)/probe-env readme

# One stage of configs/results.toml, with what it reads
STAGE_TARGETS := study chart stability timelapse bench scaling tradeoff fidelity
$(STAGE_TARGETS): setup
	$(BIN)/probe-env results $@

policies: setup
	$(BIN)/probe-env results map optimise

evaluation: setup
	$(BIN)/probe-env results evaluation any-probe

designs: setup
	$(BIN)/probe-env results countermeasures search confirmed confirmed-finely codesign driven

# an environment of its own: the other packages are no dependency
PEERS := .venv-peers
peers:
	test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check --constraint constraints-peers.txt --editable '.[peers]'
	$(PEERS)/bin/probe-env peers --output results/chart

train: setup
	$(BIN)/probe-env train configs/train/ppo.toml --output results/agents/ppo --jobs 2 --resume
	$(BIN)/probe-env train configs/train/ppo-no-tension.toml --output results/agents/ppo-no-tension --jobs 2 --resume
	$(BIN)/probe-env train configs/train/ppo-any-probe.toml --output results/agents/ppo-any-probe --jobs 2 --resume
	$(BIN)/probe-env train configs/train/student.toml --output results/agents/student --jobs 2 --resume

train-smoke: setup
	$(BIN)/pytest tests/learning/test_train.py -k smoke

# an environment of its own: RLlib pins gymnasium 1.2.2
RAY := .venv-ray
test-ray:
	test -x $(RAY)/bin/python || $(PYTHON) -m venv $(RAY)
	$(RAY)/bin/pip install --quiet --disable-pip-version-check --constraint constraints-ray.txt --editable '.[agents,dev,ray]'
	$(RAY)/bin/pytest tests/ray

# the app in a real browser: Debian's Chromium, driven by Playwright, which neither the app nor make test needs
CHROMIUM ?= /usr/bin/chromium
PICTURES ?= output/app-pictures
browser: setup
	test -x $(CHROMIUM) || { echo "installing Debian's chromium, which takes root (or name one that you have: make test-app CHROMIUM=PATH)"; \
		apt-get update && apt-get install --yes --no-install-recommends chromium; }
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[browser]'

test-app: browser
	PROBE_ENV_CHROMIUM=$(CHROMIUM) PROBE_ENV_PICTURES=$(PICTURES) $(BIN)/pytest tests/browser

# how long its user waits, stored in results/app; on a machine that does nothing else
time-app: browser
	PROBE_ENV_CHROMIUM=$(CHROMIUM) $(BIN)/python tests/browser/answers.py

readme: setup
	$(BIN)/probe-env readme

# the site to read, with warnings as errors, and the check of its links; `make test` builds and checks one of its own
SITE := output/docs
docs: setup
	rm -rf $(SITE)
	$(BIN)/python -m sphinx -q -W --keep-going --doctree-dir output/doctrees --fresh-env docs $(SITE)
	PROBE_ENV_SITE=$(SITE) $(BIN)/pytest tests/docs
	@echo "open $(CURDIR)/$(SITE)/index.html"

clean:
	rm -rf $(VENV) $(RAY) $(PEERS) $(PYTHONS:%=.venv-%) output
	find probe_env -name __pycache__ -prune -exec rm -rf {} +
