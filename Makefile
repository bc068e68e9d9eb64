# make paper   sets everything up and runs the paper's study
# make test    sets everything up and runs the tests
# make check   lint, types, import contracts, docs
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: paper test check clean

paper: $(VENV)/.paper
	@echo "Running the paper's study: $(BIN)/eiwa study run studies/paper.toml"
	@$(BIN)/eiwa study run studies/paper.toml

test: $(VENV)/.dev
	@echo "Running the tests: $(BIN)/pytest -n auto --maxprocesses 4"
	@$(BIN)/pytest -n auto --maxprocesses 4

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "eiwa needs Python 3.11 or newer, this is %s; run make PYTHON=python3.12" % sys.version.split()[0])'
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.paper: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing eiwa into $(VENV) (pinned by constraints.txt; a minute or two)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[figures]"
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing eiwa and its development tools into $(VENV) (pinned by constraints.txt)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	@touch $@ $(VENV)/.paper

clean:
	rm -rf $(VENV) docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
