# `make demo` renders and compares, `make test` checks; both first make the environment if it is not there.
.DEFAULT_GOAL := help
.PHONY: help env demo test test-all bench docs lint clean

BIN := .venv/bin
# Empty is unset: modules are compiled once, not in each of the hundred processes that tests start.
export PYTHONDONTWRITEBYTECODE :=
# Two workers: half of a test is Python and compiling on one thread.
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

help: ## this text
	@echo "étendue: global illumination for Mitsuba 3 scenes. Targets:"
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

env: .venv/stamp-dev ## the environment in .venv, with everything for development

.venv/stamp-run: requirements.lock pyproject.toml tools/bootstrap.sh tools/setup_native.py
	@sh tools/bootstrap.sh run
	@touch $@

.venv/stamp-dev: .venv/stamp-run requirements-dev.lock
	@sh tools/bootstrap.sh dev
	@touch $@

demo: .venv/stamp-run ## render the bundled caustic scene by path and by vcm, and write a page that compares them
	@$(BIN)/etendue demo

lint: .venv/stamp-dev ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --num-workers 2

test: lint ## lint, and the tests that a change must pass (minutes)
	$(PYTEST) -m "not slow and not gpu"

test-all: lint ## lint, and every test this machine can run; PART=1/4 runs the first quarter of them
	$(PYTEST) $(if $(PART),--part $(PART))

bench: .venv/stamp-dev ## cost and quality of every method against Mitsuba's path (BENCH=--record keeps the tables)
	$(BIN)/python -m benchmarks $(BENCH)

docs: .venv/stamp-dev ## the manual as a site, in build/docs; fails at links, citations and docstrings that are wrong
	$(BIN)/sphinx-build -q -W --keep-going -j 2 -b html docs build/docs
	@echo build/docs/index.html

clean: ## remove the environment and every generated file
	rm -rf .venv build dist demo-output .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
