# Two commands do everything on a fresh machine with Python 3.11 or newer:
#   make study   environment, installation, training, evaluation, report
#   make test    the same set-up, then the tests
PYTHON ?= python3
VENV ?= .venv
OUTPUT ?= results/study
BIN := $(VENV)/bin
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: study test slow-test mutants lint types check clean

study: $(VENV)/.installed-agents
	$(BIN)/hydro study --output $(OUTPUT) --resume

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest

slow-test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow

# Which one-line mutations of the code that carries the results do the tests notice? An hour on two cores.
mutants: $(VENV)/.installed-dev
	$(PIP_INSTALL) 'mutmut>=3.8,<4'
	rm -rf mutants
	$(BIN)/mutmut run
	$(BIN)/python benchmarks/mutants.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

check: lint types test

# torch comes first and by its exact version, so that no other package draws a larger build of it.
$(VENV)/.torch: constraints.txt
	$(PYTHON) -m venv $(VENV)
	@echo "Installing (a few minutes on first use) ..."
	$(PIP_INSTALL) $$(grep '^torch==' constraints.txt)
	@touch $@

$(VENV)/.installed-agents: $(VENV)/.torch pyproject.toml
	$(PIP_INSTALL) --constraint constraints.txt --editable '.[agents,render]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.torch pyproject.toml
	$(PIP_INSTALL) --constraint constraints.txt --editable '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) mutants build dist .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
