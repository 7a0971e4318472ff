# Needs python3 (3.11 or newer, with venv) and make; all else is installed into .venv from requirements.lock.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
export UV_PYTHON_DOWNLOADS := never

.PHONY: demo test bounds lint types docs check setup lock schemas clean
.DELETE_ON_ERROR:

demo: setup            ## set-up, then the main job: a two-screw case with known truth
	$(BIN)/screwpose demo -o demo-out

test: setup            ## set-up, then all tests
	$(BIN)/python -m pytest -n auto

setup: $(STAMP)        ## the environment, exactly as locked

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "screwpose needs Python 3.11 or newer: $(PYTHON) is $$($(PYTHON) --version). Try: make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	@echo "setting up .venv (a minute or two on the first run) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@test -x $(BIN)/uv || $(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements.lock
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation -e .
	@touch $(STAMP)

bounds: setup          ## the compiled loops once more, every index checked: one that is wrong writes where it must not
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=build/bounds $(BIN)/python -m pytest -n auto -q tests/projection tests/similarity

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

docs: setup            ## built strictly: a broken link or a page left out is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir build/site

check: test bounds lint types docs   ## all that CI does

lock: setup            ## new versions, with hashes, for every platform
	$(BIN)/uv pip compile --universal --generate-hashes --upgrade --quiet --python-version 3.11 --group dev pyproject.toml -o requirements.lock

clean:
	rm -rf .venv build demo-out
