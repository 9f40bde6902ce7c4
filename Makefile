# A newcomer needs two of these: `make demo` and `make test`. `make help` lists all.

# pybullet has wheels for Python 3.11; later versions compile it. Choose another with: make PYTHON=python3.12 test
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
VENV := .venv
# Many images set it. Every process of a test or a cluster would compile its modules anew: a second per cluster.
unexport PYTHONDONTWRITEBYTECODE
BIN := $(VENV)/bin
# For tests that judge no time; the last ones are divided anew. Two more than cores, as those with a cluster often wait;
# a worker or a cluster needs 0.4 GB.
JOBS := $(shell n=$$(( $$(nproc) + 2 )); echo $$(( n > 4 ? 4 : n )))
FAST := $(BIN)/python -m pytest -n $(JOBS) --dist worksteal
# the files with slow tests: to collect the others too takes longer than many of these tests
SLOW = $(shell grep -rl --include='test_*.py' 'mark\.slow' tests)

.PHONY: demo console setup test test-ray fast check docs wheel coverage bench campaigns help clean
.DEFAULT_GOAL := help

demo: $(VENV)/.ready ## set up, then show two arms at work, a halt, an insertion and a door; pictures and a film in out/
	$(BIN)/python -m examples.swapout --part insertion --speed max

console: $(VENV)/.ready ## set up, then start a cluster with a page in the browser, and print its link; Ctrl-C ends both
	$(BIN)/rtc console --up

setup: $(VENV)/.ready ## set up only: the Python environment, in .venv
	@echo "set up; next: . $(BIN)/activate"

test: $(VENV)/.ready ## set up, then run all tests
	@echo "== tests that judge no time: several at once"; $(FAST) -m "not slow or untimed"; untimed=$$?; \
	echo "== tests that judge times: one after the other"; $(BIN)/python -m pytest -m "slow and not untimed" $(SLOW) && \
	exit $$untimed

fast: $(VENV)/.ready ## the tests without processes and physics
	$(FAST) -m "not slow and not physics"

test-ray: $(VENV)/.ready ## add the extra ray (100 MB), then test workers as actors of a real Ray on this machine
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[ray]"
	$(BIN)/python -m pytest tests/deploy/test_ray_workers.py

check: $(VENV)/.ready ## lint, format, types, and the import rules of the architecture
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_architecture.py

docs: $(VENV)/.ready ## build the site of the documentation in out/site; a warning, such as a broken link, is an error
	$(BIN)/python -m sphinx -q -W --keep-going -b html -c docs/site . out/site
	@echo "the site: out/site/index.html"

wheel: $(VENV)/.ready ## build the wheel in dist/, install it outside the checkout, and run `rtc demo grasp` from it
	rm -rf build dist
	$(BIN)/python -m pip wheel -q --disable-pip-version-check --no-deps -w dist .
	dir=$$(mktemp -d) && trap 'rm -rf "$$dir"' EXIT && $(PYTHON) -m venv "$$dir/env" && \
	"$$dir/env/bin/python" -m pip install -q --disable-pip-version-check --no-compile -c constraints.txt dist/*.whl && \
	cd "$$dir" && env/bin/python -c 'from rtc.apps.console.server import STATIC; (STATIC / "vendor.js").stat()' && \
	env/bin/python -c 'import sys; from importlib.util import find_spec; \
		sys.exit(any(map(find_spec, ("broker", "workers", "sim_mcm", "deploy"))))' && \
	env/bin/python -m rtc workers --help >/dev/null && \
	env/bin/rtc demo grasp --speed max

coverage: $(VENV)/.ready ## branch coverage of the tests without processes; fails below the floor of a package
	$(FAST) -m "not slow" $(foreach package,rtc broker workers sim_mcm deploy,--cov=$(package)) --cov-branch \
		--cov-report= --cov-report=json:out/coverage.json
	$(BIN)/python -m tests.coverage_floors out/coverage.json

bench: $(VENV)/.ready ## run all benchmarks; results in benchmarks/results/
	@for file in benchmarks/[a-z]*.py; do \
		name=$$(basename $$file .py); \
		grep -q '__main__' $$file || continue; \
		echo "== $$name"; $(BIN)/python -m benchmarks.$$name || exit 1; done

campaigns: $(VENV)/.ready ## run the correctness campaigns (hours); results in tests/campaigns/results/
	@for file in tests/campaigns/[a-z]*.py; do \
		name=$$(basename $$file .py); \
		grep -q '__main__' $$file || continue; \
		if grep -q 'needs root' $$file && test "$$(id -u)" != 0; then echo "== $$name: left out, it needs root"; continue; fi; \
		echo "== $$name"; $(BIN)/python -m tests.campaigns.$$name || exit 1; done

help: ## print this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 16

clean: ## remove everything that was built, .venv too
	rm -rf $(VENV) build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.ready: pyproject.toml constraints.txt $(wildcard rtc/model/robot/_*.[ch]pp)
	@test -n "$(PYTHON)" || { echo "rtc needs Python 3.11 or later; name one with: make PYTHON=... $(MAKECMDGOALS)"; exit 1; }
	@test -x $(BIN)/python || { echo "creating $(VENV) with $(PYTHON)"; $(PYTHON) -m venv $(VENV); }
	@$(BIN)/python -c 'import sys; sys.version_info < (3, 12) or print("pybullet has no wheel for this Python: it is compiled now; this takes some minutes and needs a C++ compiler")'
	@echo "set-up: the packages of constraints.txt are downloaded and installed; one to three minutes in all"
	@rm -f $@; { $(BIN)/python -u -m pip install --progress-bar off --disable-pip-version-check -c constraints.txt \
		-e ".[dev]" && touch $@; } | { n=0; while read -r word name rest; do case "$$word $$name" in \
		"Collecting "*) n=$$((n + 1)); test $$((n % 10)) != 0 || echo "set-up: $$n packages found, up to $$name" ;; \
		"Building wheel") echo "set-up: rtc itself is built, with its compiled part if there is a C++ compiler" ;; \
		"Installing collected") echo "set-up: all is downloaded; now it is installed, which takes about half of the time" ;; \
		esac; done; }  # not awk: that of Debian reads a pipe in blocks, and would say all of this at the end
	@test -e $@  # pip has succeeded
