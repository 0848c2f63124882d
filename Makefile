# Each target sets up .venv by itself; PYTHON chooses the interpreter (3.11 or newer). `make run` installs what the
# package needs, the others what its tests need, too.
PYTHON ?= python3
# containers set it; then each process of a test would compile the package again
export PYTHONDONTWRITEBYTECODE =
# where an environment has its programs
PROGRAMS := $(if $(filter Windows_NT,$(OS)),Scripts,bin)
BIN := .venv/$(PROGRAMS)
UV := .uv/$(PROGRAMS)/uv
comma := ,
PIP := -m pip install --quiet --disable-pip-version-check --no-compile
FETCH_UV := $(PYTHON) $(PIP) --upgrade --target .uv --require-hashes --requirement requirements-uv.lock
# install into .venv: with uv, which takes a third of the time of pip and is fetched if the machine has none;
# with pip if uv fails, for example where only the settings of pip name the index
install = echo "Installing into .venv: $(1)"; { uv=$$(command -v uv) || { uv=$(UV); test -x $$uv || $(FETCH_UV); }; } 2>/dev/null && \
	$$uv venv --quiet --allow-existing --seed --python $(PYTHON) .venv && \
	$$uv pip install --quiet --python $(BIN)/python $(1) || { \
	{ $(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv .venv; } && $(BIN)/python $(PIP) $(1); }
RELEASE := .release/$(PROGRAMS)
# short tests that use every dependency
MINIMA := tests/test_api.py tests/test_compiled.py tests/test_earth.py tests/test_wheel.py tests/config \
	tests/store tests/recording tests/report/test_report.py tests/signals/test_allan.py \
	tests/signals/test_magnetic.py tests/exchange/test_export.py tests/exchange/test_log_formats.py \
	tests/navigation/test_classic.py tests/navigation/test_error_state.py tests/plugins/graph/test_graph.py \
	tests/navigation/test_random_profiles.py tests/navigation/test_unscented.py \
	tests/campaigns/test_campaign.py tests/campaigns/test_cluster.py tests/cli/test_cli.py

.PHONY: run test long short bounds lint kernels check perf league oracle minima newest lock mutants guide pictures docs \
	dist try-dist audit

run: .venv/core
	$(BIN)/bench run figure-eight -o runs/first --force

test: .venv/ready
	$(MAKE) --jobs=2 lint kernels
	$(BIN)/pytest -n auto --maxprocesses=4 --dist worksteal
	@which chromium chromium-browser google-chrome | grep -q . || \
		echo 'No Chromium here: the tests of pages in a browser were skipped.'

long: .venv/ready
	$(BIN)/pytest -m long -n auto --maxprocesses=4 --dist worksteal

# short tests that use every dependency, with the numba that is installed: BENCH_PLAIN_KERNELS=1 asks for its
# public parts alone, NUMBA_BOUNDSCHECK=1 checks every index of a kernel
short: .venv/ready
	$(BIN)/pytest $(MINIMA) -m 'not long and not slow' -n auto --maxprocesses=4 --dist worksteal

# every test with each index of a kernel checked; hours
bounds: .venv/ready
	NUMBA_BOUNDSCHECK=1 $(BIN)/pytest -n auto --maxprocesses=4 --dist worksteal

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

kernels: .venv/ready
	$(BIN)/python -m tests.kernels

check: .venv/ready
	$(BIN)/bench check

perf: .venv/perf
	$(BIN)/python -m tests.perf.ratios

# public filters on the flights of the league; about half an hour, the page bench/guide/league.md
league: .venv/league
	$(BIN)/python -m tests.league --page -o tests/league/league.json

oracle: .venv/ready
	$(BIN)/python -m tests.oracle

# the tables of bench/guide that the code declares, and the outputs of the commands on its pages
guide: .venv/ready
	$(BIN)/python -m tests.tools.guide_tables
	BENCH_WRITE_GUIDE=1 $(BIN)/pytest -q tests/workbench/test_guide.py -k every_block

# the pictures of bench/guide, taken with Chromium; about ten minutes for what they show
pictures: .venv/ready
	$(BIN)/python -m tests.tools.guide_pictures

# the documentation as a site in build/docs/site, which needs no network
docs: .venv/ready
	$(BIN)/python -m tests.tools.docs_site

# the oldest versions that pyproject.toml allows; what they warn of is not ours
minima: $(UV)
	$(UV) venv --quiet --seed --clear --python $(PYTHON) .minima
	$(UV) pip install --quiet --python .minima --resolution lowest-direct --editable '.[test]'
	.minima/$(PROGRAMS)/python -m pytest $(MINIMA) -m 'not long and not slow' --override-ini filterwarnings=default

# the newest versions of everything; what they warn of is not ours
newest: $(UV)
	$(UV) venv --quiet --seed --clear --python $(PYTHON) .newest
	$(UV) pip install --quiet --python .newest --upgrade --editable '.[test]'
	.newest/$(PROGRAMS)/python -m pytest $(MINIMA) -m 'not long and not slow' --override-ini filterwarnings=default

# what a release uploads, and the list of what it needs (SBOM); nothing leaves the machine
dist: .release/ready
	rm -rf dist build/sbom && mkdir -p build/sbom
	$(RELEASE)/python -m build --no-isolation
	$(RELEASE)/python -m twine check --strict dist/*
	$(RELEASE)/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible \
		--output-file build/sbom/ins-gnss-bench.cdx.json requirements-core.lock

# wheel and source distribution, each alone in an empty environment and an empty folder
try-dist:
	for file in dist/*.whl dist/*.tar.gz; do \
		rm -rf build/try && mkdir -p build/try/empty && $(PYTHON) -m venv build/try/env && \
		build/try/env/$(PROGRAMS)/python -m pip install --quiet --disable-pip-version-check "$$file" && \
		(cd build/try/empty && ../env/$(PROGRAMS)/bench --version && \
		../env/$(PROGRAMS)/bench run figure-eight --force -o runs) || exit 1; \
	done

# known vulnerabilities of what is installed
audit: .release/ready
	$(RELEASE)/pip-audit --strict --disable-pip --require-hashes --requirement requirements.lock
	$(RELEASE)/pip-audit --strict --disable-pip --require-hashes --requirement requirements-release.lock

.release/ready: pyproject.toml requirements-release.lock
	$(PYTHON) -m venv .release
	$(RELEASE)/python -m pip install --quiet --disable-pip-version-check --require-hashes \
		--requirement requirements-release.lock
	touch $@

# the newest versions, for every platform and Python; .venv/ready and .venv/core install these and no others
LOCK := $(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-header
lock: $(UV)
	$(LOCK) --upgrade --extra test --output-file requirements.lock pyproject.toml
	$(LOCK) --constraint requirements.lock --output-file requirements-core.lock pyproject.toml
	$(LOCK) --upgrade --group release --output-file requirements-release.lock
	echo uv | $(LOCK) --upgrade --output-file requirements-uv.lock -

$(UV): requirements-uv.lock
	$(FETCH_UV)

# errors in one package that no test notices: tests/mutants
SEED ?= 1
COUNT ?= 30
mutants: .venv/ready
	$(BIN)/python -m tests.mutants '$(PACKAGE)' --seed '$(SEED)' --count '$(COUNT)' --tests $(TESTS)

.venv/ready: pyproject.toml requirements.lock
	@$(call install,--require-hashes --requirement requirements.lock)
	@$(call install,--no-deps --editable .)
	touch .venv/core $@

.venv/core: pyproject.toml requirements-core.lock
	@$(call install,--require-hashes --requirement requirements-core.lock)
	@$(call install,--no-deps --editable .)
	touch $@

.venv/perf: .venv/ready
	@$(call install,--editable '.[test$(comma)perf]')
	touch $@

.venv/league: .venv/ready
	@$(call install,--editable '.[test$(comma)league]')
	touch $@
