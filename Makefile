# drivecal: `make help` lists what can be made. Everything runs in .venv, which is installed on first use.
.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow test-faults test-compose test-packages check check-code check-page bench train page docs format lock audit sbom clean libraries ready
BIN := .venv/bin
INSTALLED := .venv/.installed
COLLECTED := .venv/.collected
# Four processes for two cores, because tests also wait: for deadlines, and for processes that start and end.
WHOLE_FILES := $(BIN)/pytest --numprocesses 4 --dist loadfile --no-loadscope-reorder
# Long forms wait more. Five of six may have a server, a browser or Ray beside them: measured singly, they add up to 7.5 GB.
SLOW_PROCESSES = $(shell awk '/^MemAvailable/ {print ($$2 > 10000000 ? 6 : 4)}' /proc/meminfo 2>/dev/null || echo 4)
# Containers often set it. Every process that a server or a test starts would compile all that it imports: half of a start's time.
unexport PYTHONDONTWRITEBYTECODE

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

$(INSTALLED): pyproject.toml deploy/requirements.lock deploy/install.sh
	@deploy/install.sh

install: $(INSTALLED) ## install everything from the lock file into .venv

demo: $(INSTALLED) ## calibrate the highway planner in S1..S6 through the REST API, then again with other weights (minutes)
	@$(BIN)/drivecal demo

# In a new clone every process of the tests would compile the same modules and kernels at once, for half a minute each.
$(COLLECTED): $(INSTALLED)
	@$(BIN)/python -m drivecal.runtime & $(BIN)/pytest --collect-only --quiet -m "slow or not slow" >/dev/null; wait
	@touch $@

libraries: $(INSTALLED)
	@$(BIN)/python -m tests.support.web

ready: $(COLLECTED) libraries

test: ## run the tests: real SUMO, Ray, HTTP, a browser, SQLite and PostgreSQL (minutes)
	@$(MAKE) --no-print-directory --jobs 2 ready
	@$(WHOLE_FILES)

test-slow: ## run the long forms, which `make test` leaves out: whole campaigns, more kills, further cases (minutes)
	@$(MAKE) --no-print-directory --jobs 2 ready
	@$(WHOLE_FILES) --numprocesses $(SLOW_PROCESSES) -m slow

test-faults: $(INSTALLED) ## the long forms of all tests of `make test` and `make test-slow` but those in a browser: kill, stop and starve everything, every case, random examples (one to two hours)
	@$(BIN)/python -m tests.support.web
	@$(BIN)/python -m drivecal.runtime
	@failed=0; export DRIVECAL_LONG=1; \
	$(BIN)/pytest tests/faults -m faults --numprocesses 2 --dist load || failed=1; \
	$(WHOLE_FILES) -m "slow or faults or not slow" --ignore tests/faults --ignore tests/browser || failed=1; \
	exit $$failed

test-compose: $(INSTALLED) ## build, start, break, scale and restore the cluster of docker-compose.yml on a Docker engine (minutes)
	@$(BIN)/pytest tests/compose -m compose -s

test-packages: $(INSTALLED) ## build the wheel, install its three layers into fresh environments, run the demo there; read files of public projects (minutes)
	@$(BIN)/pytest tests/integration/test_wheels.py tests/integration/test_public_files.py tests/integration/test_public_roads.py -m packages -s

check: $(INSTALLED) ## lint, formatting, types, import rules, the page, the documentation
	@$(MAKE) --no-print-directory --jobs 2 --output-sync check-code check-page

check-code:
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

check-page:
	@$(BIN)/python services/web/build_hook.py check
	@$(BIN)/python docs/build.py check
	@if docker compose version >/dev/null 2>&1; then docker compose config -q; else echo "no docker compose here: docker-compose.yml is not checked"; fi

bench: $(INSTALLED) ## run the benchmarks; tables on the screen, figures in .drivecal/bench/*.json
	@$(BIN)/python tests/benchmarks/run.py

train: $(INSTALLED) ## train the hybrid vehicle and the learned comfort evaluator anew, with the tables of their model cards (minutes)
	@$(BIN)/python -m drivecal.highway.training

page: $(INSTALLED) ## build the page in the browser anew, where its sources changed; the server shows it at once
	@$(BIN)/python services/web/build_hook.py

docs: $(INSTALLED) ## write the reference from the code, and build the documentation; the server shows it at once under /help
	@$(BIN)/python docs/reference.py
	@$(BIN)/python docs/build.py

format: $(INSTALLED) ## format the code and mend what the linter can
	@$(BIN)/ruff check --fix-only .
	@$(BIN)/ruff format .

lock: $(INSTALLED) ## write deploy/requirements.lock anew from pyproject.toml (needs uv)
	@deploy/lock.sh --upgrade

audit: $(INSTALLED) ## report known weaknesses of the locked packages; 1 if there are, 0 without a network (needs uv)
	@$(BIN)/python deploy/audit.py

sbom: ## write the packages of each image as CycloneDX, with known weaknesses, to .drivecal/sbom (needs uv and a network)
	@deploy/sbom.sh

clean: ## remove the environment, caches and the results of demo and bench; your own database stays
	rm -rf .venv .drivecal/demo .drivecal/bench .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
