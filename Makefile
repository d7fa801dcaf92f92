# Two commands do everything for a newcomer: `make demo` and `make test`. Both make .venv and install the package into it.
# PYTHON=/path/to/python3.11 picks the interpreter, JOBS=n how many tests or cases run at a time, ARGS=… is passed on.

JOBS ?= 2
SEED ?= 1
COUNT ?= 300
PY := .venv/bin/python
SOURCES := twin_diagram tests .make $(wildcard sims)

# What belongs to another environment (ROS, conda, a user's pip habits) must not leak into .venv.
unexport PYTHONPATH PYTHONHOME PIP_USER PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV
# Without bytecode each process that the tests start compiles all again: 31 s of processor time to gather the tests, not 8.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONNOUSERSITE := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Two processes with one thread each are faster than one with two, and more repeatable.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.SILENT:

.PHONY: help
help:
	echo "make demo       an object picked, carried and placed in simulation, then a gap found and closed; writes out/demo/"
	echo "make test       ruff, mypy and the fast tests"
	echo "make long       tests that take some seconds each; CI runs them, too"
	echo "make slow       the slow tests"
	echo "make wheels     sdist and wheel, installed in fresh environments (all, and slim) and used there"
	echo "make newcomer   one's own arm, log, effect, controller and filter from an empty folder, with the time of each step"
	echo "make front-door what hurt newcomers, old beside new; ARGS=--quick takes minutes"
	echo "make lint       ruff alone"
	echo "make typecheck  mypy alone"
	echo "make house      the structure of the code, measured, beside its aims; ARGS='--list floors' names what counts"
	echo "make mutants    faults put into the maths, one at a time: who survives the fast tests? SEED=1 COUNT=300; an hour"
	echo "make docs       the handbook, offline; runs the tutorials; writes out/docs/html/"
	echo "make bench      timings of the systems"
	echo "make gap-benchmark  hidden effects in simulated arms, found and scored; hours; writes out/gap_benchmark/"
	echo "make false-alarms   ten simulated hours of a healthy arm; an hour or two; writes out/false_alarms/"
	echo "make hrt-tables     the filter's experiments beside the outline's; hours; writes out/hrt_tables/"
	echo "make clean      remove .venv, out and caches"

# First of all, and before anything is made or fetched: an interpreter that fits, and the system libraries the wheels need.
.PHONY: check
check:
	python=$$(.make/python.sh "$(PYTHON)") && "$$python" -c "import sys; from twin_diagram import native; sys.exit(native.main())"

# The package and one set of its extras, in .venv.
.PHONY: install-demo install-test install-bench install-docs
install-demo install-test install-bench install-docs: install-%: check
	python=$$(.make/python.sh "$(PYTHON)") && .make/install.sh "$$python" $*

.PHONY: demo
demo: install-demo
	$(PY) sims/closed_loop.py --scenario demo --out out/demo $(ARGS)
	echo
	$(PY) sims/close_the_gap.py --out out/demo/gap

.PHONY: test
test: lint loops typecheck pytest

# Compiles the loops of registration and planning, by tests that need them, and in a fresh checkout the tests themselves,
# while types are checked: nobody waits for it.
.PHONY: loops
loops: install-test
	{ $(PY) -m pytest -q -p no:cacheprovider tests/planning/mpc/test_active_set.py \
		tests/assets/building/test_from_mesh.py::test_a_built_object_is_found_in_a_picture; \
	ls tests/twin/__pycache__/*-pytest-*.pyc || $(PY) -m pytest -q -p no:cacheprovider --collect-only; } >/dev/null 2>&1 &

.PHONY: lint
lint: install-test
	$(PY) -m ruff check $(SOURCES)

.PHONY: typecheck
typecheck: install-test
	if $(PY) -c 'import sys; sys.exit(sys.version_info >= (3, 11))'; then \
		echo "mypy: left out on CPython 3.10, whose last NumPy types arrays' shapes in a way that later ones gave up"; \
	else $(PY) -m mypy; fi

# Exits with an error where an aim is missed.
.PHONY: house
house: install-test
	$(PY) .make/house.py $(ARGS)

# Fails on warnings, on tutorials that print something else than their pages say, and on pages that would load from a network.
.PHONY: docs
docs: install-docs
	$(PY) .make/handbook $(ARGS)

.PHONY: pytest
pytest: install-test
	$(PY) -m pytest -n $(JOBS) --dist worksteal $(ARGS)

.PHONY: long
long: install-test
	$(PY) -m pytest -n $(JOBS) --dist worksteal -m long $(ARGS)

.PHONY: slow
slow: install-test
	$(PY) -m pytest -n $(JOBS) --dist worksteal -m slow $(ARGS)

# Goes on where it stopped. ARGS='--only planning' draws from one package or file, ARGS=--list shows what is drawn,
# ARGS=--survivors who survived so far, ARGS='--show ID' one of them, ARGS=--again runs the survivors against new tests.
.PHONY: mutants
mutants: install-test
	$(PY) .make/mutants --seed $(SEED) --count $(COUNT) --jobs $(JOBS) $(ARGS)

# Asks the package index for `build` and, in a fresh environment, for what .make/slim.txt names.
.PHONY: wheels
wheels: install-test
	$(PY) -m pytest -m slow tests/test_installed.py $(ARGS)

.PHONY: newcomer
newcomer: install-test
	$(PY) sims/benchmarks/newcomer.py $(ARGS)

# Its wild motions are those of a test, which needs pytest.
.PHONY: front-door
front-door: install-test install-bench
	$(PY) sims/benchmarks/front_door.py $(ARGS)

.PHONY: bench
bench: install-bench
	$(PY) sims/closed_loop.py --duration 10 --out out/bench

# Goes on where it stopped. ARGS='--only single --limit 20' does a part, ARGS='--suite training' the other seeds.
.PHONY: gap-benchmark
gap-benchmark: install-bench
	$(PY) sims/benchmarks/gap_benchmark.py run --suite final --jobs $(JOBS) --out out/gap_benchmark $(ARGS)

# Goes on where it stopped. ARGS='--hours 1' does a part.
.PHONY: false-alarms
false-alarms: install-bench
	$(PY) sims/benchmarks/false_alarms.py --out out/false_alarms $(ARGS)

# Goes on where it stopped. ARGS=--quick takes minutes.
.PHONY: hrt-tables
hrt-tables: install-demo
	$(PY) sims/benchmarks/hrt_tables.py run --jobs $(JOBS) --out out/hrt_tables $(ARGS)

.PHONY: clean
clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
