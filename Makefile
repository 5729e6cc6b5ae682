# Two commands do everything on a fresh machine with Python 3.11 or newer:
#   make study   environment, installation, training, evaluation, report
#   make test    the same set-up, then the tests
PYTHON ?= python3
VENV ?= .venv
# One process per core; a file of tests stays in one process, so that its fixtures are made once. The order of files is
# that of tests/conftest.py.
WORKERS ?= -n auto --dist loadfile --no-loadscope-reorder
OUTPUT ?= results/study
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
BIN := $(VENV)/bin
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: install study test slow-test faults lint types check docs figures versions release clean

install: $(VENV)/.installed-agents
	$(BIN)/python benchmarks/compile_all.py

study: $(VENV)/.installed-agents
	$(BIN)/hydro study --output $(OUTPUT) --resume

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(WORKERS)

slow-test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow $(WORKERS)

# Do the tests notice thirty faults that somebody could make? Half an hour.
faults: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/seeded_faults.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

check: lint types test

# The documentation as a site that opens from disk; a warning or a broken link is an error.
docs: $(VENV)/.installed-dev
	$(BIN)/python docs/playground/build_page.py
	$(BIN)/python -m sphinx -q -W --keep-going -c docs . build/site -d build/doctrees
	$(BIN)/python docs/check_links.py build/site

# sdist and wheel, checked and tried in clean environments; URL=https://… is the address of the repository.
release: $(VENV)/.torch
	$(BIN)/python benchmarks/release.py --url '$(URL)'

# Every published figure again, a day on two cores; finished ones stay. `benchmarks/figures.py --list` shows the plan.
figures: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.figures

versions:
	$(PYTHON) benchmarks/release.py --versions

# torch comes first and by its exact version, so that no other package draws a larger build of it. The plain index has
# a build with several gigabytes of GPU libraries for some machines; PyTorch's own index has the one for processors.
$(VENV)/.torch: constraints.txt
	$(PYTHON) -m venv $(VENV)
	@echo "Installing (a few minutes on first use) ..."
	@torch=$$(grep '^torch==' constraints.txt); \
	if $(PIP_INSTALL) --no-deps --timeout 10 --retries 1 --index-url $(TORCH_INDEX) $$torch 2>$(VENV)/torch.log; \
	then echo "$$torch: installed the CPU build ($(TORCH_INDEX) was asked first)"; \
	else echo "$$torch: not available from $(TORCH_INDEX) (see $(VENV)/torch.log); taking the plain package index," \
	    "which may add 5 GB of GPU libraries (set TORCH_INDEX to another index with the CPU build)"; \
	    $(PIP_INSTALL) --constraint constraints.txt $$torch; fi
	@touch $@

$(VENV)/.installed-agents: $(VENV)/.torch pyproject.toml
	$(PIP_INSTALL) --constraint constraints.txt --editable '.[agents,video,export]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.torch pyproject.toml
	$(PIP_INSTALL) --constraint constraints.txt --editable '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) .versions build dist .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
