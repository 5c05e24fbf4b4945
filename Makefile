# `make run` and `make test` set up everything they need in .venv; python3 (3.11 or newer) with venv is all they ask.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
ARGS   ?=
# Workers for the tests that compute, in the background, one for each of two cores; and for those that pass real time,
# which mostly wait and run at the same time: tests/support/passes.py.
WORKERS ?= 2
WAITING ?= 10
# Seed of the choice of small wrong changes; another one each day unless one is named.
SEED ?= $(shell date +%Y%m%d)
# Bytecode is kept, whatever the environment says: else hundreds of processes would compile the same files again.
test test-quick: export PYTHONDONTWRITEBYTECODE =
# The arrays are small: a thread for each core would only wait for more work, in a loop that takes up the core.
test test-quick: export OPENBLAS_NUM_THREADS = 1

.PHONY: run test test-quick mutations lint docs deb format clean help

help:
	@echo "make run   [ARGS='--speed 1']   the service on the simulated rig with its dashboard, 60 times real speed, until Ctrl-C"
	@echo "make test  [ARGS='-k bridge']   the whole test suite"
	@echo "make test-quick                 the fast tests, in about a minute: none with a simulated rig or real processes"
	@echo "make mutations [ARGS='solar']   which share of small mistakes, put into a copy of the source, the tests notice: before a release, on an idle machine"
	@echo "make lint                       ruff, ruff format --check, mypy (for Linux and for Windows), import-linter"
	@echo "make docs                       the documentation as a site, in site/html; fails if a link leads nowhere"
	@echo "make deb                        the Debian package of this checkout, in dist/"
	@echo "make format                     ruff's fixes and formatting"
	@echo "make clean                      remove the virtual environment and caches"

$(BIN)/.runtime: deploy/lock/runtime.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "heliocube needs Python 3.11 or newer: make run PYTHON=python3.11"; exit 2; }
	@echo "setting up $(VENV): once, a minute or two; what is fetched stands below"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r deploy/lock/runtime.txt
	$(BIN)/python -m pip install --disable-pip-version-check --no-deps -e .
	@touch $@

$(BIN)/.dev: deploy/lock/dev.txt $(BIN)/.runtime
	$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r deploy/lock/dev.txt
	@touch $@

$(BIN)/.docs: deploy/lock/docs.txt $(BIN)/.runtime
	$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r deploy/lock/docs.txt
	@touch $@

run: $(BIN)/.runtime
	@$(BIN)/heliocube run --dashboard $(ARGS)

test: $(BIN)/.dev
	$(BIN)/python -m tests.support.passes $(WORKERS) $(WAITING) $(ARGS)

test-quick: $(BIN)/.dev
	$(BIN)/python -m pytest --quick -n $(WORKERS) --dist worksteal $(ARGS)

mutations: $(BIN)/.dev
	$(BIN)/python -m tests.mutation.reach reach.json tests/solar tests/drivers tests/daemon --live without
	$(BIN)/python -m tests.mutation.run --reach reach.json --seed $(SEED) --limit 120 --jobs $(WORKERS) $(ARGS)

lint: $(BIN)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --no-warn-unreachable --follow-imports=silent -p solar -p drivers -p daemon
	MYPYPATH=deploy $(BIN)/mypy -p boot
	$(BIN)/lint-imports

docs: $(BIN)/.docs
	$(BIN)/python docs/site/build.py

deb:
	deploy/deb/build $(ARGS)

format: $(BIN)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
