# One environment, pinned by constraints.txt; every target sets it up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete

.PHONY: setup demo test lint types study bench timelapse stability policies evaluation tradeoff fidelity readme clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a few minutes the first time"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[agents,dev]'
	touch $(STAMP)

demo: setup
	$(BIN)/probe-env evaluate constant slow-down pi configs/schedules/example.csv --limit 4 --fidelity fast --output output/demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

test: lint types
	$(BIN)/pytest --numprocesses 2 --dist loadscope

study: setup
	$(BIN)/probe-env study --members 8 --output results/study

bench: setup
	$(BIN)/probe-env bench --output results/bench

timelapse: setup
	$(BIN)/probe-env timelapse --output results/timelapse

stability: setup
	$(BIN)/probe-env stability --output results/stability

policies: setup
	$(BIN)/probe-env optimise best-constant --trials 24
	$(BIN)/probe-env optimise best-schedule --trials 64

evaluation: setup
	$(BIN)/probe-env evaluate constant slow slow-down on-off pi best-constant best-schedule configs/schedules/example.csv --fidelity fast --output results/evaluation

tradeoff: setup
	$(BIN)/probe-env tradeoff --limit 6 --output results/tradeoff

fidelity: setup
	$(BIN)/probe-env evaluate constant pi best-schedule --limit 8 --fidelity fast --check-fidelity half-step --output results/fidelity

readme: setup
	$(BIN)/probe-env readme

clean:
	rm -rf $(VENV) output
	find probe_env -name __pycache__ -prune -exec rm -rf {} +
