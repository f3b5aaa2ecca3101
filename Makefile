# `make demo` and `make test` set everything up first, on a fresh machine with Python 3.13 or 3.11: the newest of
# these that runs, or the one that PYTHON names.
PYTHON := $(or $(PYTHON),$(shell for each in python3.13 python3.11; do $$each -c '' 2>/dev/null && echo $$each && break; done))
VENV := .venv
# Tests run side by side in so many processes; a process that has none left takes some of the other's.
WORKERS ?= 2
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PARALLEL := -n $(WORKERS) --dist worksteal
# Without bytecode, every process of a test run would compile all modules and rewrite all assertions again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo docs lint test test-whole test-nightly test-twin test-usb
.PHONY: nightly crash fuzz soak mutants full-disk faults release bench clean

# `make` alone installs nothing.
help:
	@echo "make setup      sets up $(VENV) and nothing else: downloads about 1 GB, takes 3 GB of disk and 2 to 4 minutes on a fast line"
	@echo "make demo       sets up, then measures three artefacts on the virtual bench: out/demo/report.html, 2 to 5 minutes"
	@echo "make test       sets up, then runs the quick tests, 5 minutes on two cores; make test-whole: those that a merge waits for"
	@echo "make docs       sets up, then builds the documentation as a site, with its pictures: build/docs/site/index.html"
	@echo "make lint       style, types, and which package may import which"
	@echo "make clean      removes $(VENV), out, build and dist"
	@echo "more, explained in the Makefile: bench faults nightly (crash full-disk fuzz mutants soak test-nightly test-usb) release test-twin"
	@echo "make takes python3.13 or python3.11, or the one of PYTHON=/path/to/python"

setup: $(READY)

$(READY): pyproject.toml constraints-3.11.txt constraints-3.13.txt
	@test -n "$(PYTHON)" || { echo "neither python3.13 nor python3.11 runs here; install one, or give PYTHON=/path/to/it"; exit 1; }
	@echo "Setting up $(VENV) with $(PYTHON), $$($(PYTHON) --version)"
	@echo "pip is silent while it downloads about 1 GB and installs it; that takes some minutes"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,dev]' \
		--constraint constraints-$$($(BIN)/python -c 'import sys; print("%d.%d" % sys.version_info[:2])').txt
	$(BIN)/python -m fpplab.core.system
	$(BIN)/python -m tests.support.warmup
	touch $(READY)

demo: setup
	$(BIN)/python -m fpplab demo --out out/demo --force

test: setup
	$(BIN)/python -m pytest -m 'not slow' $(PARALLEL)

# What a merge waits for beside the quick tests.
test-whole: setup
	$(BIN)/python -m pytest -m 'whole and not nightly' $(PARALLEL)

# Repeats, rare conditions and long runs.
test-nightly: setup
	$(BIN)/python -m pytest -m nightly $(PARALLEL)

# What depends on the versions of NumPy and Blender: all devices, the simulation, and the demonstration, of whose
# tests those alone that judge its figures and its report.
test-twin: setup
	$(BIN)/python -m pytest -m 'not slow or demonstration' $(PARALLEL) -k "not test_demo.py or test_demo_" \
		tests/cli/test_demo.py tests/conformance tests/sim

# All that takes hours; with -k, the others follow where one fails.
nightly: SECONDS = 300
nightly: test-nightly test-usb mutants fuzz crash soak full-disk

# The projector's driver through a real kernel: a virtual machine of Debian's packages, unpacked into build/vm.
test-usb: setup
	$(BIN)/python -m tests.vm

# Everything that reads files or bytes of others under atheris, SECONDS for each target.
SECONDS ?= 1800
fuzz: setup
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS) --jobs $(WORKERS)

# 500 scans and 100 reconnections of each device in one process, which may not grow.
soak: setup
	$(BIN)/python -m tests.soak

# Faults that are listed, and others drawn on the syntax of the sources: the tests have to notice 95 % of them.
mutants: setup
	$(BIN)/python -m tests.mutants --workers $(WORKERS)

# Writing commands on disks that are full at every write or vanish midway; root alone can mount such disks.
full-disk: setup
	$(BIN)/python -m tests.full_disk

# The listed faults alone, most of them mistakes of drivers.
faults: setup
	$(BIN)/python -m tests.mutants listed --workers $(WORKERS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	printf '%s\n' 'linux -p benchmarks' 'win32 --cache-dir .mypy_cache/win32' 'darwin --cache-dir .mypy_cache/darwin' | \
		xargs -L 1 -P $(WORKERS) $(BIN)/mypy -p fpplab -p drivers -p sim --platform
	$(BIN)/lint-imports

# The documentation as a site, build/docs/site/index.html; its pages are run first, for their pictures.
docs: setup
	$(BIN)/python -m docs.generate

# What has to hold before a release; leaves wheel and bill of materials in dist/.
release: setup
	$(BIN)/python -m tests.release

bench: setup
	$(BIN)/python -m benchmarks

# Commands killed, interrupted and started twice, hundreds of times; an hour, and an interrupted run goes on.
crash: setup
	$(BIN)/python -m benchmarks.crash

clean:
	rm -rf $(VENV) .venv-other out build dist
