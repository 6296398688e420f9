PYTHON      ?= python3
VENV        ?= .venv
CONSTRAINTS ?= constraints.txt
BIN         := $(VENV)/bin
VERSION     := $(shell $(PYTHON) -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])')
STAMP       := $(VENV)/.installed-$(VERSION)

# Each library at its work: kernels, both SDP solvers, RTKLIB, tables, receiver logs, Dask, report.
SMOKE := tests/test_readme.py tests/test_examples.py tests/packaging tests/filters/test_jit.py \
	tests/filters/test_measurement_update.py tests/alignment/test_verdict.py \
	tests/alignment/reference/test_sdp.py::test_cvxpy_agrees tests/datasets/text \
	tests/datasets/formats/test_receiver_logs.py tests/datasets/formats/test_oakville.py \
	tests/velocity/study tests/nav/test_sweep.py tests/nav/results

.PHONY: demo test smoke newest docs setup lint types clean

demo: setup            ## simulate a city drive in the GREAT layout, navigate it, write the report
	$(BIN)/certnav demo

test: lint types       ## lint, types, tests, each benchmark once; another Python: make test PYTHON=python3.13
	$(BIN)/pytest -n auto
	$(BIN)/pytest -q --benchmark-disable benchmarks

smoke: types           ## types, and a minute of tests that use every library
	$(BIN)/pytest -n auto $(SMOKE)

newest:                ## types and tests with the newest versions of everything, in .venv-newest
	rm -rf .venv-newest
	$(MAKE) types VENV=.venv-newest CONSTRAINTS=
	.venv-newest/bin/pytest -n auto

setup: $(STAMP)        ## make .venv and install certnav with what the tests need

# A venv of another Python is made anew: its stamp has another name.
$(STAMP): pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or later, please")'
	$(PYTHON) -m venv $(if $(wildcard $(STAMP)),,--clear) $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		$(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[test]"
	mkdir -p $(VENV)/typing && ln -sfn "$(CURDIR)" $(VENV)/typing/certnav  # where mypy finds it
	touch $@

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	MYPYPATH=$(VENV)/typing $(BIN)/mypy

docs: setup            ## the documentation as a site, in site/: strict, no dead link
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		$(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[docs]"
	rm -rf .venv/documented && mkdir -p .venv/documented/certnav
	for part in nav alignment velocity filters datasets __init__.py lazy.py; do \
		ln -s "$(CURDIR)/$$part" .venv/documented/certnav/$$part; done
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

clean:
	rm -rf .venv .venv-* results site
