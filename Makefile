# Each target sets up .venv by itself; PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test long lint kernels check perf oracle mutants
SEED ?= 1
COUNT ?= 30

run: .venv/ready
	$(BIN)/bench run figure-eight --force

test: .venv/ready
	$(MAKE) --jobs=2 lint kernels
	$(BIN)/pytest -n auto --maxprocesses=4 --dist worksteal

long: .venv/ready
	$(BIN)/pytest -m long -n auto --maxprocesses=4 --dist worksteal

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

kernels: .venv/ready
	$(BIN)/python -m tests.kernels

check: .venv/ready
	$(BIN)/bench check

perf: .venv/perf
	$(BIN)/python -m tests.perf.ratios

oracle: .venv/ready
	$(BIN)/python tests/oracle.py

mutants: .venv/ready
	$(BIN)/python -m tests.mutants '$(PACKAGE)' --seed '$(SEED)' --count '$(COUNT)' --tests $(TESTS)

.venv/ready: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@

.venv/perf: .venv/ready
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,perf]'
	touch $@
