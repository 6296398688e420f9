PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: demo test setup lint clean

demo: setup            ## simulate a city drive in the GREAT layout, navigate it, write the report
	$(BIN)/certnav demo

test: setup lint       ## lint, types, tests
	$(BIN)/pytest -n auto

setup: $(STAMP)        ## make .venv and install certnav with what the tests need

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	mkdir -p $(VENV)/typing && ln -sfn ../.. $(VENV)/typing/certnav  # where mypy finds it
	touch $(STAMP)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) results
