# Two commands do everything on a fresh machine with Python >= 3.11 and make:
#   make demo   the main job, end to end, on the embedded synthetic rig
#   make test   everything that CI runs
# Both make their own virtual environment in .venv.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/demo

.PHONY: help demo test lint types unit book docs format bench clean

help:
	@sed -n 's/^#   //p' Makefile

# A stamp per set of packages, so that the installation runs again only when pyproject.toml changes.
$(VENV)/.made:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "stereocal needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.run: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.dev: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $(VENV)/.run $@

demo: $(VENV)/.run
	$(BIN)/stereocal demo --out $(OUT)

test: lint types unit book

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.dev
	$(BIN)/mypy

unit: $(VENV)/.dev
	$(BIN)/pytest -n auto

# Notebooks are run by the tests; the book that CI builds shows them without output. `make docs` runs them as well.
book: $(VENV)/.dev
	STEREOCAL_DOCS_NOTEBOOKS=off $(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/check

docs: $(VENV)/.dev
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html
	@echo "open docs/_build/html/index.html"

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev
	$(BIN)/pytest benchmarks --benchmark-only -p no:xdist

clean:
	rm -rf $(VENV) out build dist docs/_build docs/_generated .mypy_cache .ruff_cache .pytest_cache .hypothesis
