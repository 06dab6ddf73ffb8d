# `make demo` and `make test` set up everything they need; a second run is quick.

BIN := .venv/bin
READY := .venv/.ready
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-fast lint typecheck format hooks clean distclean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

setup: $(READY) ## virtual environment with the locked packages

$(READY): pyproject.toml requirements.lock scripts/setup.sh
	@scripts/setup.sh
	@touch $@

demo: $(READY) ## synthetic rooms, reconstructed and compared with the truth, into demo/
	$(BIN)/fewview demo --out demo

test: lint typecheck ## lint, types, all tests
	OMP_NUM_THREADS=1 $(BIN)/pytest -n $(JOBS)

test-fast: $(READY) ## the tests without the slow ones
	OMP_NUM_THREADS=1 $(BIN)/pytest -n $(JOBS) -m "not slow"

lint: $(READY) ## ruff: rules and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

typecheck: $(READY) ## mypy, strict
	$(BIN)/mypy

format: $(READY) ## let ruff rewrite
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

hooks: $(READY) ## run lint and types before every commit
	$(BIN)/pre-commit install

clean: ## remove what runs and builds left
	rm -rf build dist demo *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find fewview scripts tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## also remove the virtual environment
	rm -rf .venv
