# Two commands on a fresh machine: `make study` and `make test`.
# Needs git, make and Python >= 3.11; sets up the rest and says what it does.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/study
# What `make study` studies: bundled scenes (`mibvh scenes list`), each of about this many triangles.
SIZE   ?= 10000
SCENES ?= cornell livingroom hairball city_italian vegetation powerplant

# How long `make fuzz` tries damaged and hostile input, and from which seed.
FUZZ_SECONDS ?= 300
FUZZ_SEED    ?= 0

.PHONY: study test lint fuzz setup lock clean

study: setup
	$(BIN)/mibvh study $(addsuffix @$(SIZE),$(SCENES)) -o $(OUT)

test: setup
	$(BIN)/python -m pytest

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

fuzz: setup
	FUZZ_SECONDS=$(FUZZ_SECONDS) FUZZ_SEED=$(FUZZ_SEED) $(BIN)/python -m tools.fuzz

setup: $(VENV)/installed
	@PYTHON=$(BIN)/python sh tools/ensure_llvm.sh

$(VENV)/installed: pyproject.toml requirements.lock
	@echo "Setting up $(VENV) with $$($(PYTHON) --version) and the locked dependencies ..."
	@$(PYTHON) -c 'import sys; sys.exit("mibvh needs Python 3.11 or newer, not " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

# Needs uv; writes the versions that `make setup` installs.
lock:
	uv pip compile --quiet --universal --python-version 3.11 --extra dev --no-emit-index-url --no-annotate --no-header -o requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) out
