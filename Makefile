# Two commands do everything on a fresh machine: `make bench` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PYTHONSAFEPATH := 1

.PHONY: setup setup-dev setup-locked audit bench docs test test-slow baseline fuzz fuzz-inputs fuzz-guided torture lint types clean

bench: setup
	$(BIN)/bench run start > /dev/null # the report prints the leaderboard
	$(BIN)/bench report
	@echo
	@echo 'next, with photos of your own:'
	@echo '  $(BIN)/bench ingest PHOTOS my_scene && $(BIN)/bench fit auto my_scene --out my_model'

# the site, from docs/ and the code; any warning is an error, and nothing is fetched
docs: $(VENV)/.installed-docs
	$(BIN)/sphinx-build -q -W --keep-going -b html docs build/site
	@echo "site: build/site/index.html"

# a worker a core and two more (tests/conftest.py); a file's tests share what its fixtures made, so they stay on
# one worker; the longest files come
# first (tests/conftest.py), not those with most tests
test: setup-dev
	$(BIN)/pytest -q -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder --durations 40 --durations-min 5

# budgets of time and memory are measured alone; planted faults share nothing
test-slow: setup-dev
	$(BIN)/pytest -q -m slow --ignore tests/mutations
	$(BIN)/pytest -q -m slow -n auto --maxprocesses 8 tests/mutations

# what tests/regression and the instruction counts are held against; CONTRIBUTING.md says when it may be renewed
baseline: setup
	rm -rf build/regression
	$(BIN)/bench run tests/regression/regression.toml --out build/regression --threads 1
	$(BIN)/bench compare regression build/regression || true
	$(BIN)/bench baseline save regression build/regression --replace
	$(BIN)/bench study instructions --out baselines

# odd input to the native layer under AddressSanitizer and UndefinedBehaviorSanitizer, then under ThreadSanitizer
fuzz: setup-dev
	$(BIN)/pip install -q -c constraints.txt nanobind cmake
	$(BIN)/python tests/fuzz/sanitized.py
	$(BIN)/python tests/fuzz/sanitized.py --kind threads

# damaged files of every kind to every reader, a million of them; goes on where it was ended
fuzz-inputs: setup-dev
	PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python tests/fuzz/inputs.py

# the readers that are Python, by what they cover: atheris has builds for some Pythons alone, so nothing else needs it
fuzz-guided: setup-dev
	$(BIN)/pip install -q atheris
	PYTHONPATH=tests $(BIN)/python -P tests/fuzz/guided.py

# commands killed at random moments, started again, and held against undisturbed ones
torture: setup-dev
	PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python tests/torture/rounds.py

lint: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup-dev
	$(BIN)/pyrefly check

setup: $(VENV)/.installed
setup-dev: $(VENV)/.installed-dev

# as setup-dev, but every file must have a hash of hashes.txt; for Linux, Python 3.11 and torch's CPU build alone
setup-locked: | $(VENV)/bin/pip
	$(BIN)/pip install -q --no-deps --require-hashes -r hashes.txt
	$(BIN)/pip install -q --no-deps --no-build-isolation -e .
	@touch $(VENV)/.installed $(VENV)/.installed-docs $(VENV)/.installed-dev

# what is known against the pinned versions; needs a network, and fails where anything could not be asked
audit:
	@test -x build/audit/bin/pip-audit || ($(PYTHON) -m venv build/audit && build/audit/bin/pip install -q pip-audit)
	build/audit/bin/pip-audit --strict --no-deps --disable-pip -r constraints.txt

SOURCES := pyproject.toml constraints.txt CMakeLists.txt $(wildcard methods/kernels/csrc/* methods/kernels/CMakeLists.txt)

$(VENV)/bin/pip:
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(SOURCES) | $(VENV)/bin/pip
	@echo 'installing into $(VENV): torch and others are downloaded (2 GB on disk), native code is compiled; this takes minutes'
	@$(BIN)/pip install -q -c constraints.txt -e .
	@touch $@
	@echo 'ready: source $(VENV)/bin/activate; then bench --help'

# one step: resolving and building once for the package and once for its extras would take longer
$(VENV)/.installed-dev: $(SOURCES) | $(VENV)/bin/pip
	$(BIN)/pip install -q -c constraints.txt -e '.[dev,distributed,docs]'
	@touch $(VENV)/.installed $(VENV)/.installed-docs $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/pip install -q -c constraints.txt -e '.[docs]'
	touch $@

clean:
	rm -rf build docs/metrics docs/methods $(VENV)
