# SPDX-License-Identifier: Apache-2.0
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.installed
NODE_READY := tests/node/node_modules/.installed
ROS2_READY := tests/ros2/.venv/.installed
SAMPLE := recordings/samples/edgar-street.mcap

# One worker runs a module, so that its fixtures are made once. Tests wait at times: three workers keep two cores busy.
PYTEST := $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

# A process runs folders that import the same libraries: workers would import all of them each, and report every test.
# The readers' tests mostly wait, so there are three processes for two cores.
QUICK := $(BIN)/python -m pytest -q -m "not slow" --fail-slow 2
NUMBERS := tests/unit tests/property

# Linters, tests and installations wait often enough to run beside each other, on two cores too.
MAKEFLAGS += --jobs=3

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Compiled modules are kept wherever make runs: without them each start of Python takes longer than most tests.
export PYTHONDONTWRITEBYTECODE :=
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help libraries pictures demo check test nightly quick-tests quick-numbers quick-others quick-readers test-kernel test-kernels mutate lint pytest node ros2 bench bench-tables sample docs docs-pictures site format constraints clean

help: ## List the targets.
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22

demo: $(READY) ## Set everything up, then calibrate the embedded sample.
	@$(BIN)/multilica demo

check: lint quick-tests ## Run the linters and the quick tests; a minute.

quick-tests: quick-numbers quick-others quick-readers

quick-numbers: $(READY)
	$(QUICK) $(NUMBERS)

quick-readers: $(READY)
	$(QUICK) tests/ingest

quick-others: $(READY)
	$(QUICK) tests $(patsubst %,--ignore=%,$(NUMBERS) tests/ingest)

test: lint pytest test-kernel ## Set everything up, then run all checks and tests; ten minutes.

nightly: export MULTILICA_NIGHTLY := 1
nightly: lint pytest test-kernels ## Run all tests with all their cases, and the kernels of three CPUs.

test-kernel: $(READY)
	$(BIN)/python -m tests.kernels --push

test-kernels: $(READY) ## Run the tests that could depend on the CPU with the kernels of three CPUs.
	$(BIN)/python -m tests.kernels

mutate: $(READY) ## Change one place of a module at a time, and count the changes that its tests notice; an hour or less.
	$(BIN)/python tests/mutate.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

pytest: $(READY) pictures node ros2
	$(PYTEST) --fail-slow 2

bench: $(READY) ## Measure every claim on simulated and real scenes; an hour or more.
	$(BIN)/python -m tests.bench

bench-tables: $(READY) ## Write docs/benchmark.md: the paper's tables on simulated rigs; 15 minutes of CPU time.
	$(BIN)/python -m tests.bench tables

sample: $(READY) ## Make the embedded sample anew.
	$(BIN)/multilica simulate --rig edgar --scene street --seed 1 --frames 2 --keep-every 4 --sensors ideal --out $(SAMPLE)

docs: $(READY) ## Write the pages of docs/reference that are made from the code.
	$(BIN)/python -m docs.site.generated_pages

site: $(READY) ## Build the documentation as a site, in build/site.
	$(BIN)/sphinx-build -q -W --keep-going -n -b html -c docs/site docs build/site
	@echo "open build/site/index.html"

docs-pictures: $(READY) pictures node ## Draw docs/pictures anew and check the output that the pages quote; a few minutes.
	$(BIN)/python -m tests.documentation_pictures

format: $(READY) ## Format the code, fix what the linter can fix.
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

constraints: ## Write constraints.txt from a fresh environment with the newest versions.
	@fresh=$$(mktemp -d) && trap 'rm -rf "$$fresh"' EXIT && $(PYTHON) -m venv "$$fresh" \
	&& "$$fresh/bin/python" -m pip install --quiet --upgrade 'pip>=25.1' \
	&& "$$fresh/bin/python" -m pip install --quiet --editable '.[all]' --group dev \
	&& "$$fresh/bin/python" -m pip freeze --exclude-editable > constraints.txt

clean: ## Remove the environment and what tools cached.
	rm -rf $(VENV) tests/node/node_modules tests/ros2/.venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build

libraries:
	@$(PYTHON) .ci/system_libraries.py

pictures: | libraries
	@$(PYTHON) .ci/system_libraries.py --pictures

$(READY): pyproject.toml constraints.txt | libraries
	@echo "installing into $(VENV): 2.4 GB, a minute or a few"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	@$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[all]' --group dev
	@$(BIN)/python -m pip install --quiet --no-deps ouster-sdk==1.0.1 \
	|| echo "tests of Ouster's packets are skipped: ouster-sdk has no wheel for this machine"
	@$(BIN)/python -m compileall -qq -j 0 -x '/(plotly|tests)/' $(VENV)/lib || true  # on all cores, and only what is imported
	@touch $@

node: $(NODE_READY)

$(NODE_READY): tests/node/package.json | libraries
	@if command -v npm >/dev/null && npm install --prefix tests/node --no-package-lock --no-audit --no-fund --silent; \
	then touch $@; else echo "tests that read with npm packages are skipped: npm is missing or failed"; fi

ros2: $(ROS2_READY)

$(ROS2_READY): tests/ros2/requirements.txt | libraries
	@if $(PYTHON) -m venv tests/ros2/.venv && tests/ros2/.venv/bin/pip install --quiet --prefer-binary -r $<; \
	then touch $@; else rm -rf tests/ros2/.venv; echo "a test that reads with ROS 2 is skipped: no wheels for this machine"; fi
