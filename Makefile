# Two commands do everything: `make demo` and `make test`. Works with GNU make 3.81.

# The first Python that is new enough and can make virtual environments
PYTHON := $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
PIP_FLAGS =
VENV := .venv
RUN := $(VENV)/bin/python -m

.PHONY: demo fuzz test test-all test-oldest test-versions pytest-test pytest-test-all lint format bench benchmark docs clean

demo: $(VENV)/.installed
	$(RUN) matcam demo --output demo --force

# Two test processes on two cores: a matrix product that starts two threads of its own in each waits for itself
test test-all test-oldest test-versions: export OPENBLAS_NUM_THREADS = 1

# Tables are as large as what the C library returns to the system at once: asking for it again costs a tenth of the time
test test-all test-oldest test-versions: export MALLOC_MMAP_THRESHOLD_ = 1000000000
test test-all test-oldest test-versions: export MALLOC_TRIM_THRESHOLD_ = 4000000000

# Processes that tests start load the package as it was compiled before
test test-all test-oldest test-versions: export PYTHONDONTWRITEBYTECODE =

# Most tests compile a program and run it once: most do without XLA's optimisation (tests/conftest.py).
# `test-all` runs the programs as users do
test test-oldest test-versions: export MATCAM_TESTS_COMPILE_QUICKLY = 1

# mypy runs beside the tests: one after the other, it would leave a core idle
test test-all: $(VENV)/.installed-test
	$(MAKE) -j 2 lint pytest-$@

# The tests, or some of them (TESTS="tests/core tests/files"), on the oldest versions that pyproject.toml allows, ...
test-oldest:
	mkdir -p build
	$(PYTHON) .ci/oldest.py > build/oldest.txt
	$(MAKE) pytest-test VENV=build/oldest PYTHON=python3.11 PIP_FLAGS="--constraint build/oldest.txt"

# ... and with the newest versions on every Python that is at hand
test-versions:
	for version in 3.11 3.12 3.13 3.14; do \
		python$$version -c pass 2>/dev/null || { echo "python$$version is not at hand: not tested"; continue; }; \
		$(MAKE) pytest-test VENV=build/python$$version PYTHON=python$$version || exit 1; done

TESTS =
# A file's tests stay in one process: what the first has traced serves the others
pytest-test: $(VENV)/.installed-test
	$(RUN) pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow" $(TESTS)

pytest-test-all: $(VENV)/.installed-test
	$(RUN) pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.installed-test
	$(RUN) ruff format --check .
	$(RUN) ruff check .
	$(RUN) mypy
	$(VENV)/bin/lint-imports --no-logo

format: $(VENV)/.installed-test
	$(RUN) ruff check --fix .
	$(RUN) ruff format .

# An hour; MATCAM_FUZZ_SECONDS says how long instead. `make test` runs a fixed share
fuzz: $(VENV)/.installed-test
	PYTHONPATH=. $(RUN) tests.files.fuzz

# Two of the scripts import tests.oracle, which is not installed. Results go to benchmarks/results and benchmarks/RESULTS.md
bench: $(VENV)/.installed-test
	for script in benchmarks/bench_*.py; do PYTHONPATH=. $(VENV)/bin/python $$script || exit 1; done
	$(VENV)/bin/python benchmarks/results.py

# Methods against each other on tables and photographs of known truth (docs/validation/recovery.md). Continues where it was stopped
benchmark: $(VENV)/.installed-benchmark
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=. $(RUN) benchmarks.recovery run --workers 2

# Every example is executed; warnings, bad links and what would be loaded from outside are errors
docs: $(VENV)/.installed-docs
	rm -rf build/site docs/gallery docs/tutorials docs/reference/api docs/reference/commands
	$(RUN) sphinx -b html -n -W --keep-going docs build/site
	@echo "Open build/site/index.html"

clean:
	rm -rf $(VENV) demo build docs/gallery docs/tutorials

# Stamp files: pip runs again only when pyproject.toml has changed
$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "matcam needs Python 3.11 or newer with venv and ensurepip: install python3 and python3-venv (Debian, Ubuntu), or Python from python.org"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.installed: $(VENV)/.made pyproject.toml
	$(RUN) pip install --quiet $(PIP_FLAGS) --editable .
	touch $@

$(VENV)/.installed-docs: $(VENV)/.made pyproject.toml
	$(RUN) pip install --quiet $(PIP_FLAGS) --editable '.[docs]'
	touch $(VENV)/.installed $@

$(VENV)/.installed-benchmark: $(VENV)/.made pyproject.toml
	$(RUN) pip install --quiet $(PIP_FLAGS) --editable '.[benchmark]'
	touch $(VENV)/.installed $@

$(VENV)/.installed-test: $(VENV)/.made pyproject.toml
	$(RUN) pip install --quiet $(PIP_FLAGS) --editable '.[test]'
	touch $(VENV)/.installed $@
