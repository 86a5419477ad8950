# The whole developer interface. Every target creates what it needs first.
PYTHON ?= python3
ENV := . ./env.sh

.DEFAULT_GOAL := help
.PHONY: help setup demo test train train-setup lint bench lock clean

help: ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1	/' | expand -t 20

setup: ## create what is missing of the environment and build the packages
	@$(PYTHON) scripts/setup_environment.py

demo: setup ## map -> plan -> simulated flight -> mission upload, with a report in out/demo/
	@bash -c '$(ENV) && exec python scripts/demo.py $(DEMO)'

test: train-setup ## run all tests
	@bash -c '$(ENV) && exec python -m pytest -n 2 --dist worksteal $(TESTS)'

train-setup: ## setup, and PyTorch for training (planning does without)
	@$(PYTHON) scripts/setup_environment.py --train

train: train-setup ## train a policy (TRAIN="config/sac.yaml --seed 1"; config/improvement.yaml improves models/sac_plain)
	@bash -c '$(ENV) && exec wisar train $(or $(TRAIN),config/sac.yaml)'

lint: train-setup ## ruff and the type checker
	@bash -c '$(ENV) && ruff check . && ruff format --check . && mypy src scripts'

bench: ## the benchmark against the named peers (BENCH="--only search" for a part)
	@$(PYTHON) scripts/setup_environment.py --bench
	@mkdir -p out
	@bash -c '$(ENV) && exec wisar bench --json out/bench.json $(BENCH)'

lock: setup ## pin the newest versions of requirements*.in
	@bash -c '$(ENV) && exec bash scripts/lock_requirements.sh'

clean: ## remove everything that setup and runs made
	rm -rf .venv .cache build install log out
