# One environment, pinned by constraints.txt; every target sets it up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete

.PHONY: setup demo test lint types study bench timelapse stability readme clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a few minutes the first time"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[agents,dev]'
	touch $(STAMP)

demo: setup
	$(BIN)/probe-env study --subset --members 1 --duration 4 --output output/demo

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

readme: setup
	$(BIN)/probe-env readme

clean:
	rm -rf $(VENV) output
