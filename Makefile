# `make quick` and `make test` need nothing but Python 3.11 and pip; see CONTRIBUTING.md.
BIN := .venv/bin
# One thread a process: the tests run in two processes. Bytecode is kept, whatever the shell says: a hundred processes
# that tests start would else compile the same modules again. A file goes to one process, so that what its tests share
# is made once.
TEST_ENV := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=

.PHONY: help setup quick test lint format bench data docs clean

help:
	@echo "make quick   set up, generate the quick light stage, run the protocol, write the report"
	@echo "make test    set up, run the tests"
	@echo "make lint    ruff and mypy          make format  let ruff mend what it can"
	@echo "make bench   measure speed          make data    generate the quick light stage only"
	@echo "make docs    the documentation as a site, in build/site"
	@echo "make clean   remove what was built; results in runs/ and generated data stay"

setup:
	@bash maintainer/setup.sh

quick: setup
	$(BIN)/handbench run quick

test:
	@bash maintainer/setup.sh test
	$(TEST_ENV) $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	bash maintainer/typecheck.sh $(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup
	$(BIN)/python -m benchmarks

data: setup
	$(BIN)/handbench data make openstage --size quick

docs:
	@bash maintainer/setup.sh docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -not -path './.git/*' -prune -exec rm -rf {} +
