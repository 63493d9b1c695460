# Two commands on a fresh machine: `make study` and `make test`; `make help` lists the others.
# Needs git, make and Python >= 3.11; sets up the rest and says what it does.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/study
# What `make study` studies: bundled scenes (`mibvh scenes list`), each of about this many triangles.
SIZE   ?= 10000
SCENES ?= cornell livingroom hairball city_italian vegetation powerplant

# Test files that run side by side.
WORKERS ?= 2

# How long `make fuzz` tries damaged and hostile input, and from which seed.
FUZZ_SECONDS ?= 300
FUZZ_SEED    ?= 0

# `make results SCENES=FOLDER`: the experiments, the folder of the study, and what else is asked for,
# such as `RESULTS="--minutes 45 --without sanmiguel"` or `RESULTS=--pages-only`.
EXPERIMENTS  ?= prediction,depth,rotation,sensitivity
RESULTS_OUT  ?= out/results
RESULTS      ?=

.PHONY: help study test test-fast coverage test-lowest test-wheel lint docs fuzz results bundled setup lock clean

help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1: /p' $(MAKEFILE_LIST) | awk -F': ' '{ printf "make %-12s %s\n", $$1, $$2 }'

study: setup ## Study SCENES of SIZE triangles each; tables and report in OUT
	$(BIN)/mibvh study $(addsuffix @$(SIZE),$(SCENES)) -o $(OUT)

test: setup ## Run all tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

test-fast: setup ## Run the tests that take seconds (no studies, clusters, browsers, notebooks)
	$(BIN)/python -m pytest -m fast -n $(WORKERS) --dist loadfile

coverage: setup ## Run all tests, and list the lines of Python that none of them ran
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --skip-covered --show-missing

test-lowest: ## Run some tests with the oldest dependencies that pyproject.toml allows
	PYTHON=$(PYTHON) sh tools/test_lowest.sh

test-wheel: ## Build wheel and sdist, install each alone, and run what a user would
	PYTHON=$(PYTHON) sh tools/test_wheel.sh

lint: setup ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/docs ## Make the site of docs/ and the API; fails on any warning
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "out/docs/index.html"

fuzz: setup ## Try hostile input for FUZZ_SECONDS from FUZZ_SEED
	FUZZ_SECONDS=$(FUZZ_SECONDS) FUZZ_SEED=$(FUZZ_SEED) $(BIN)/python -m tools.fuzz

results: setup ## Study SCENES=FOLDER of folders with a scene.xml; write docs/results, figures, quoted numbers
	$(BIN)/python -m tools.results $(SCENES) -o $(RESULTS_OUT) --experiments $(EXPERIMENTS) $(RESULTS)

bundled: setup ## Study all bundled scenes with all builders; write docs/results/bundled.md
	$(BIN)/python -m tools.results.all_builders -o out/bundled

setup: $(VENV)/installed ## Make the environment, in .venv
	@PYTHON=$(BIN)/python sh tools/ensure_llvm.sh

$(VENV)/installed: pyproject.toml requirements.lock
	@echo "Setting up $(VENV) with $$($(PYTHON) --version) and the locked dependencies ..."
	@$(PYTHON) -c 'import sys; sys.exit("mibvh needs Python 3.11 or newer, not " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

$(VENV)/docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

# Needs uv.
lock: ## Write the versions that `make setup` installs
	uv pip compile --quiet --universal --python-version 3.11 --extra dev --no-emit-index-url --no-annotate --no-header -o requirements.lock pyproject.toml

clean: ## Remove the environment and results
	rm -rf $(VENV) out
