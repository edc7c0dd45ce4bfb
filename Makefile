# Two commands do everything on a fresh machine with Python 3.11 or later:
#   make demo   install into .venv and fly two simulated copters
#   make test   install and pass the tests
#   make test-more   all cases of all tests, including those that `make test` samples or leaves out
#   make test-sitl ARDUCOPTER=... PX4=...   the tests that need simulators of real autopilots
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-more test-sitl oracles simulate chaos fuzz fuzz-decoders bench lint locks clean

demo: $(VENV)/.installed
	$(BIN)/lfield up --deploy examples/01-first-flight/mission.dL --all --sim --until-done

# Printed last if the browser for the tests of the page of `lfield watch` is missing.
NO_BROWSER = command -v chromium >/dev/null && command -v chromedriver >/dev/null || \
	echo "NOT TESTED: the page of lfield watch in a browser; sudo apt-get install chromium chromium-driver"

LINT = $(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/lint-imports && $(BIN)/mypy

# Lint and types run in parallel with the tests and are printed after them; each can fail the target. A background job does
# not receive Ctrl-C, so the trap ends it. The first run compiles all modules to byte code once; otherwise each worker
# would compile them.
test: $(VENV)/.tested
	@setsid sh -c '$(LINT)' >$(VENV)/lint.log 2>&1 & lint=$$!; \
	trap 'kill -- -$$lint 2>/dev/null; exit 130' INT TERM; \
	test -e $(VENV)/.compiled || $(BIN)/pytest --collect-only --numprocesses 0 >/dev/null && touch $(VENV)/.compiled; \
	$(BIN)/pytest; tests=$$?; \
	wait $$lint; checks=$$?; cat $(VENV)/lint.log; $(NO_BROWSER); \
	test $$tests -eq 0 && test $$checks -eq 0

test-more: $(VENV)/.tested
	$(BIN)/pytest --every-case

# lfield on real autopilots (sim-adapters/REAL.md): each variable is the path of a simulator's executable, optionally
# followed by its options, or the ENDPOINT[,SECOND] of a running simulator. ONLY=limits,kit selects checks.
ARDUCOPTER ?=
ARDUROVER ?=
PX4 ?=
test-sitl: $(VENV)/.tested
ifeq ($(strip $(ARDUCOPTER)$(ARDUROVER)$(PX4)),)
	@echo "skipped: no simulator was given; make test-sitl ARDUCOPTER=build/sitl/bin/arducopter PX4=build/px4_sitl_default/bin/px4"
else
	ARDUCOPTER="$(ARDUCOPTER)" ARDUROVER="$(ARDUROVER)" PX4="$(PX4)" LFIELD_SITL=yes ONLY="$(ONLY)" \
		$(BIN)/pytest -n 0 --timeout 3600 -p no:cacheprovider -v tests/sitl/test_sitl.py
endif

# Whole teams on simulated computers: random scenarios from seeds, checked by invariants; then planted bugs that the
# simulation must find. make simulate FIRST=10000 uses other seeds.
SEEDS ?= 10000
FIRST ?= 0
simulate: $(VENV)/.tested
	$(BIN)/python tests/simulate/simulate.py --seeds $(SEEDS) --first $(FIRST)
	$(BIN)/python tests/simulate/simulate.py --pushes --seeds $(SEEDS) --first $(FIRST)
	$(BIN)/python tests/planted/catalogue.py --run tests/simulate

# Real processes that are killed, stopped, disconnected and out of disk space, for SECONDS. Full disks are mounted in a
# separate mount namespace, where the system allows this.
SECONDS ?= 120
SEED ?= 1
chaos: $(VENV)/.tested
	$$(unshare -Urm true 2>/dev/null && echo unshare -Urm) $(BIN)/python tests/chaos/run.py --seconds $(SECONDS) --seed $(SEED) \
		$(if $(filter zenoh,$(OVER)),--zenoh)

# Rewrites the golden files that a refactoring must not change (tests/oracles); `git diff tests/oracles` shows changes.
oracles: $(VENV)/.tested
	$(BIN)/python tests/simulate/simulate.py --seeds 2000 --outcomes tests/oracles/outcomes.txt
	$(BIN)/pytest -n 0 --every-case --rewrite --ignore tests/oracles/test_outcomes.py tests/oracles

lint: $(VENV)/.tested
	$(LINT)

# make fuzz COUNT=1000 SEED=1      compares the WebAssembly engine with the reference engine on random programs
COUNT ?= 1000
SEED ?= 1
fuzz: $(VENV)/.tested
	$(BIN)/python tests/fuzz/fuzz.py --count $(COUNT) --seed $(SEED)

# make fuzz-decoders COUNT=10000 SEED=1 [ONLY=bundle,block]      random and mutated input for every decoder
fuzz-decoders: $(VENV)/.tested
	$(BIN)/python tests/decoders/run.py --count $(COUNT) --seed $(SEED) --only "$(ONLY)"

# make bench ONLY=hop,local   only these figures   make bench SAVE=rows.json   also writes the rows to a file
# make bench AGAINST=PATH     compares with another checkout that has its own .venv, in alternating rounds
# make bench ROUNDS=30        measures for longer
# make bench ONLY=hop,rankings,compiler,collector,agreement,together SAVE=tests/benchmarks/rows.json PICTURE=lfield/docs/figures.svg
bench: $(VENV)/.measured
	$(BIN)/python tests/benchmarks/run.py --only "$(ONLY)" $(if $(SAVE),--save "$(SAVE)") $(if $(PICTURE),--picture "$(PICTURE)") \
		$(if $(AGAINST),--against "$(AGAINST)") $(if $(ROUNDS),--rounds $(ROUNDS))

# deploy/locks lists the version and hash of every installed package, including build dependencies.
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check
LOCKED = $(INSTALL) --require-hashes --requirement deploy/locks/$(1).txt && \
	$(INSTALL) --no-deps --no-build-isolation --editable .

$(VENV)/.installed: pyproject.toml deploy/locks/desk.txt
	$(PYTHON) -m venv $(VENV)
	$(call LOCKED,desk)
	touch $@

$(VENV)/.tested: $(VENV)/.installed deploy/locks/test.txt
	$(call LOCKED,test)
	touch $@

$(VENV)/.measured: $(VENV)/.tested deploy/locks/bench.txt
	$(call LOCKED,bench)
	touch $@

# run.txt includes pip for robots: the vendor's Python may lack it.
LOCK = printf 'editables\nhatchling\n$(if $(filter run,$(1)),pip\n)' | \
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes \
	--no-header --no-annotate --no-emit-index-url \
	$(addprefix --extra ,$(2) $(3) $(4) $(5)) --output-file deploy/locks/$(1).txt pyproject.toml -

# Locks the newest versions that pyproject.toml allows, for all supported Python versions and processors, and tests them.
locks: $(VENV)/.tested
	$(INSTALL) uv
	$(call LOCK,run,all,zenoh) && $(call LOCK,desk,desk) && \
		$(call LOCK,test,desk,test) && $(call LOCK,bench,desk,test,bench)
	$(MAKE) test

clean:
	rm -rf $(VENV) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
