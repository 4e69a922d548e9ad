# One environment, pinned by constraints.txt; every target sets it up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete

# pip leaves compiling Python files to their first import, which must then be kept
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test lint types kernels study bench timelapse stability chart peers scaling policies train train-smoke evaluation designs tradeoff fidelity test-ray readme clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a few minutes the first time"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[agents,dev]'
	touch $(STAMP)

demo: setup
	$(BIN)/probe-env evaluate constant slow-down pi configs/schedules/example.csv --limit 4 --fidelity fast --output output/demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

kernels: setup
	$(BIN)/python -m probe_env.compile_kernels

test: setup
	$(MAKE) --jobs=2 --output-sync=target lint types kernels
	$(BIN)/pytest --numprocesses 2 --dist worksteal

study: setup
	$(BIN)/probe-env study --members 8 --output results/study

bench: setup
	$(BIN)/probe-env bench --output results/bench

timelapse: setup
	$(BIN)/probe-env timelapse --output results/timelapse

stability: setup
	$(BIN)/probe-env stability --output results/stability

scaling: setup
	$(BIN)/probe-env scaling --output results/scaling

chart: setup
	$(BIN)/probe-env chart --output results/chart
	cp results/chart/measured_errors.csv probe_env/measured_errors.csv
	$(BIN)/probe-env readme

# an environment of its own: the other packages are no dependency
PEERS := .venv-peers
peers:
	test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check --constraint constraints-peers.txt --editable '.[peers]'
	$(PEERS)/bin/probe-env peers --output results/chart

policies: setup
	$(BIN)/probe-env map --output results/map
	$(BIN)/probe-env optimise

train: setup
	$(BIN)/probe-env train configs/train/ppo.toml --output results/agents/ppo --jobs 2 --resume
	$(BIN)/probe-env train configs/train/ppo-no-tension.toml --output results/agents/ppo-no-tension --jobs 2 --resume
	$(BIN)/probe-env train configs/train/ppo-any-probe.toml --output results/agents/ppo-any-probe --jobs 2 --resume

train-smoke: setup
	$(BIN)/pytest tests/test_train.py -k smoke

AGENTS := $(foreach k,0 1 2 3 4,ppo@$(k)=results/agents/ppo/seed-$(k)/agent.npz)
BLIND := $(foreach k,0 1 2 3 4,ppo-no-tension@$(k)=results/agents/ppo-no-tension/seed-$(k)/agent.npz)
ANY := $(foreach k,0 1 2,ppo-any-probe@$(k)=results/agents/ppo-any-probe/seed-$(k)/agent.npz)
GENERAL := results/agents/ppo-any-probe/seed-0/agent.npz

evaluation: setup
	$(BIN)/probe-env evaluate constant slow-down pi best-constant best-schedule best-schedule-by-diameter tension-scheduled adaptive privileged configs/schedules/example.csv $(AGENTS) $(BLIND) $(ANY) --against best-schedule --fidelity fast --output results/evaluation
	$(BIN)/probe-env evaluate constant best-schedule pi tension-scheduled adaptive ppo=results/agents/ppo/seed-0/agent.npz $(ANY) --probes random --against best-schedule --fidelity fast --output results/any-probe

designs: setup
	$(BIN)/probe-env compare $(foreach name,original longer-guide larger-guide-floats smaller-carrier-floats improved,configs/design/$(name).toml) --output results/design/countermeasures
	$(BIN)/probe-env design --feed constant --trials 160 --output results/design/search
	$(BIN)/probe-env compare configs/design/improved.toml configs/design/original.toml results/design/search/found.toml --full --fidelity fast --limit 24 --output results/design/confirmed
	$(BIN)/probe-env compare configs/design/improved.toml results/design/search/found.toml --full --fidelity reference --limit 24 --output results/design/confirmed-finely
	$(BIN)/probe-env design --full --fidelity fast --feed $(GENERAL) --trials 48 --contexts 16 --output results/design/codesign
	$(BIN)/probe-env compare configs/design/improved.toml configs/design/original.toml results/design/search/found.toml results/design/codesign/found.toml --full --fidelity fast --feed $(GENERAL) --limit 24 --output results/design/driven

tradeoff: setup
	$(BIN)/probe-env tradeoff constant slow-down on-off pi tension-scheduled privileged --beside best-schedule $(AGENTS) --limit 6 --output results/tradeoff

fidelity: setup
	$(BIN)/probe-env evaluate best-schedule tension-scheduled ppo=results/agents/ppo/seed-0/agent.npz --limit 8 --fidelity fast --check-fidelity all --output results/fidelity

# an environment of its own: RLlib pins gymnasium 1.2.2
RAY := .venv-ray
test-ray:
	test -x $(RAY)/bin/python || $(PYTHON) -m venv $(RAY)
	$(RAY)/bin/pip install --quiet --disable-pip-version-check --constraint constraints-ray.txt --editable '.[agents,dev,ray]'
	$(RAY)/bin/pytest tests_ray

readme: setup
	$(BIN)/probe-env readme

clean:
	rm -rf $(VENV) $(RAY) $(PEERS) output
	find probe_env -name __pycache__ -prune -exec rm -rf {} +
