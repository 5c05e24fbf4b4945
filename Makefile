# `make run` and `make test` set up everything they need in .venv; python3 (3.11 or newer) with venv is all they ask.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
ARGS   ?=
# As many as two cores carry: what the tests wait for is real and needs its share of them.
WORKERS ?= 2

.PHONY: run test lint format clean help

help:
	@echo "make run   [ARGS='--speed 1']   the service on the simulated rig with its dashboard, 60 times real speed, until Ctrl-C"
	@echo "make test  [ARGS='-k bridge']   the whole test suite"
	@echo "make lint                       ruff, ruff format --check, mypy, import-linter"
	@echo "make format                     ruff's fixes and formatting"
	@echo "make clean                      remove the virtual environment and caches"

$(BIN)/.runtime: deploy/lock/runtime.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "heliocube needs Python 3.11 or newer: make run PYTHON=python3.11"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r deploy/lock/runtime.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

$(BIN)/.dev: deploy/lock/dev.txt $(BIN)/.runtime
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r deploy/lock/dev.txt
	@touch $@

run: $(BIN)/.runtime
	@$(BIN)/heliocube run --dashboard $(ARGS)

test: $(BIN)/.dev
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(ARGS)

lint: $(BIN)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(BIN)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
