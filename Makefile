# make demo | docs | images | wheel | release | quick | check | test | test-all | attack | lint | bench | bench-dense | bench-peers | sanitize | campaign | pairs | clean;
# each installs what it needs into .venv first.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PIP    := $(BIN)/python -m pip --quiet --disable-pip-version-check

# Tests start hundreds of processes, of which each would compile all modules for itself.
unexport PYTHONDONTWRITEBYTECODE

NATIVE := $(shell find mbocp/_native \( -name '*.cpp' -o -name '*.hpp' -o -name CMakeLists.txt -o -name locate.py \))

.PHONY: demo docs pages images wheel try-wheel try-arm release quick check test test-all attack lint bench bench-dense bench-peers sanitize campaign pairs setup clean

demo: setup
	$(BIN)/mbocp solve examples/arms/ur5_reach.toml -o ur5_reach.h5 --replay ur5_reach.html --plot ur5_reach.png

# The site, in build/site. Examples are solved and photographed first, those whose files have changed (build/gallery; half an hour
# for all of them, once); `make pages` makes the pages alone. A warning is an error.
SPHINX := $(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --jobs auto --builder html docs build/site

docs: setup
	$(PIP) install --group docs
	$(BIN)/python docs/site/make_gallery.py
	$(SPHINX)
	@echo build/site/index.html

# The pictures that pages hold, anew: from results of the gallery and the commands on the pages. Needs Chromium.
images: setup
	$(PIP) install --group docs
	$(BIN)/python docs/site/make_images.py

pages: setup
	$(PIP) install --group docs
	$(SPHINX)
	@echo build/site/index.html

# A wheel of the native part for this Python, in dist/, with the manylinux tag that this machine's compiler and glibc allow. What the
# wheels of Pinocchio, CasADi and Boost bring is not copied into it: RPATHs lead to them (mbocp/_native/CMakeLists.txt).
OTHERS := libpinocchio* libcasadi* libboost_serialization*

wheel: setup
	$(PIP) install --group wheel
	rm -rf build/wheel dist/mbocp-*.whl && $(PIP) wheel . --no-deps --no-build-isolation --wheel-dir build/wheel
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/auditwheel repair $(foreach name,$(OTHERS),--exclude '$(name)') --wheel-dir dist build/wheel/*.whl
	$(BIN)/auditwheel show dist/*.whl

# A new environment, no compiler, a motion: says how long each step takes.
try-wheel:
	.ci/try_wheel.sh dist/*.whl

# The same for aarch64, in an emulator, with tests: says what it needs.
try-arm: setup
	$(PIP) install --group wheel
	.ci/try_arm.sh

# All of a release but its tag: one version everywhere, a source archive, and its wheel in a new environment.
release: setup
	$(BIN)/python -m pytest -q tests/test_repository.py
	rm -rf build/release
	$(BIN)/python -c 'from scikit_build_core.build import build_sdist; build_sdist("build/release")'
	$(PIP) wheel build/release/*.tar.gz --no-deps --no-build-isolation --wheel-dir build/release
	.ci/try_wheel.sh build/release/*.whl
	@echo 'git tag v$(shell $(BIN)/python -c "import mbocp; print(mbocp.__version__)") and git push --tags publish it'

# One process more than cores (conftest.py), at most eight; the tests of a file stay together, the longest files first.
PARALLEL := -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# Levels stand in tests/levels.py: what is quick, for every save; each feature solved, for every commit; all but the
# slow tests, before a push.
quick: setup
	$(BIN)/python -m pytest $(PARALLEL) -m 'unit and not slow'

check: lint
	$(BIN)/python -m pytest $(PARALLEL) -m '(unit or solve) and not slow'

test: setup
	$(BIN)/python -m pytest $(PARALLEL) --durations 20

test-all: setup
	$(BIN)/python -m pytest $(PARALLEL) -m 'slow or not slow' --durations 20

# COUNT mutated inputs, a tenth of them guided by coverage where atheris has a wheel for this Python.
COUNT ?= 100000

attack: setup
	-$(PIP) install atheris
	$(BIN)/python -m tests.attack --count $(COUNT) --guided 10 --log attack.jsonl

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run --Werror $(filter %.cpp %.hpp,$(NATIVE))

bench: setup
	$(BIN)/python -m benchmarks

# Beside Crocoddyl, mim_solvers and CasADi; installs what these need into the user's cache, once.
bench-peers: setup
	$(BIN)/python -m benchmarks.peers

# The kernel's small dense algebra against Eigen's, operation by operation.
bench-dense: setup
	$(BIN)/python -m cmake -G Ninja -S mbocp/_native -B build/bench -DPython_EXECUTABLE=$(abspath $(BIN)/python) \
	    -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) >/dev/null
	$(BIN)/python -m cmake --build build/bench --target dense_bench_avx2
	build/bench/dense_bench_avx2

# The native part with every access checked: its tests, in a build of its own (a quarter of an hour, once).
sanitize: setup
	.ci/sanitize.sh

# Random valid problems, each result verified by a second opinion; rows in build/campaign.jsonl, where it goes on.
campaign: setup
	$(BIN)/python -m tests.campaign

# All pairs of features of problem files, compiled and solved; rows in build/pairs.jsonl, where it goes on.
pairs: setup
	$(BIN)/python -m tests.pairs

setup: $(STAMP)

# The build requirements come from pyproject.toml, so that they are written once.
$(STAMP): pyproject.toml papers/pyproject.toml $(NATIVE)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null \
	    || { echo "mbocp needs Python 3.10 or newer (Debian: apt install python3), or set PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	    || { echo "Python's venv module is missing (Debian: apt install python3-venv)" >&2; exit 1; }
	@command -v $(CXX) >/dev/null \
	    || { echo "a C++ compiler is missing (Debian: apt install g++)" >&2; exit 1; }
	@$(PYTHON) -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' \
	    || { echo "Python.h is missing (Debian: apt install python3-dev)" >&2; exit 1; }
	@echo 'Installing into $(VENV) and compiling the native part: a few minutes, once.'
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(PIP) install --upgrade pip
	$(BIN)/python .ci/build_requirements.py | $(PIP) install --no-compile -r /dev/stdin
	$(PIP) install --no-compile --no-build-isolation -e '.[dev]' -e papers
	@touch $@

clean:
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache ur5_reach.h5 ur5_reach.html ur5_reach.png
