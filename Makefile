# HapticLOD. `make` lists what there is. One CMake tree (build/release) holds the station, the tests, the benchmarks and
# the Python module, which lands in hapticlod/: after a change in C++ or Python, `make build` is enough.
.DEFAULT_GOAL := help
SHELL := /usr/bin/env bash
PYTHON ?= python3
export PYTHON
# Packages are installed uncompiled (scripts/bootstrap): forbidden to keep what it compiles, every process would do it again.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
# ninja cannot take part in make's own sharing of jobs, and says so at length.
# As many compilers as cores: two trees are built at the same time, and with ninja's own two more each they wait for each other's memory.
BUILD := MAKEFLAGS= CMAKE_BUILD_PARALLEL_LEVEL=$(shell nproc 2>/dev/null || echo 2) cmake --build
RELEASE := build/release
SANITIZED := build/sanitized
# The sanitized build is also the second compiler's: clang where there is one.
SANITIZED_CXX := $(shell command -v clang++ || command -v c++)
# Sources joined compile in half the time, and run as fast (docs/decisions.md D34). Who edits one of them: make build UNITY=OFF
UNITY ?= ON
CMAKE_FLAGS := -DCMAKE_UNITY_BUILD=$(UNITY) -DCMAKE_UNITY_BUILD_BATCH_SIZE=12 -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja -DHAPTICLOD_WERROR=ON
CPP_FILES = $(shell git ls-files --cached --others --exclude-standard 'runtime/*.cpp' 'runtime/*.hpp' 'runtime/*.h' 'runtime/*.inl' 'examples/*.c')
PY_DIRS := $(wildcard hapticlod tuning benchmarks tests scripts examples)

.PHONY: help setup tools configure build product test test-cpp test-sanitized test-sanitized-build test-threads test-hidraw-vm test-usb-vm test-service-vm test-circle \
    test-python lint format demo bench bench-quick bench-station bench-open bench-static soak fuzz station-static \
    evaluate-surrogate bench-tuners optimiser-cases scans-table soak-scans mutate-scans full-mouth clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 22

setup:  ## system packages (as root or with sudo), .venv, Python packages
	@scripts/bootstrap

tools:  # enough to compile
	@scripts/bootstrap tools

configure: setup
	@mkdir -p build
	@cmake -S . -B $(RELEASE) $(CMAKE_FLAGS) -DCMAKE_BUILD_TYPE=Release -DHAPTICLOD_INPLACE=ON \
	    -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python >$(RELEASE).log 2>&1 || { cat $(RELEASE).log; exit 1; }
	@ln -sf ../../$(RELEASE)/hapticlod-station $(BIN)/hapticlod-station

build: configure  ## the station, the Python module, tests and benchmarks
	@$(BUILD) $(RELEASE)

CROSS ?=
STATIC := build/static$(addprefix -,$(CROSS))
station-static: setup  ## one hapticlod-station without run-time dependencies: make station-static [CROSS=aarch64-linux-gnu]
	@mkdir -p build
	@cmake -S . -B $(STATIC) $(CMAKE_FLAGS) -DCMAKE_BUILD_TYPE=Release -DHAPTICLOD_PYTHON=OFF -DHAPTICLOD_TESTS=OFF \
	    -DHAPTICLOD_STATIC=ON $(if $(CROSS),-DCMAKE_TOOLCHAIN_FILE=$(CURDIR)/runtime/cross.cmake -DHAPTICLOD_CROSS=$(CROSS)) \
	    >$(STATIC).log 2>&1 || { cat $(STATIC).log; exit 1; }
	@$(BUILD) $(STATIC) --target hapticlod-station
	@stat -c '%n: %s bytes' $(STATIC)/hapticlod-station

product: configure  ## the station and the Python module alone
	@$(BUILD) $(RELEASE) --target hapticlod-station _runtime _runtime_stub

# Fetching packages and checking types keep one core busy: the sanitized build and the C++ tests have the other meanwhile.
test: tools  ## everything CI runs
	@$(MAKE) --no-print-directory --output-sync=target -j 2 build test-sanitized-build
	@$(MAKE) --no-print-directory --output-sync=target -j 3 lint test-sanitized test-cpp
	@$(MAKE) --no-print-directory test-python

test-cpp: build  ## C++ tests, release build
	@ctest --test-dir $(RELEASE) --output-on-failure --no-tests=error -j 2

test-sanitized-build: tools
	@mkdir -p build
	@cmake -S . -B $(SANITIZED) $(CMAKE_FLAGS) -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_FLAGS=-O1 -DHAPTICLOD_PYTHON=OFF \
	    -DCMAKE_CXX_COMPILER=$(SANITIZED_CXX) \
	    -DHAPTICLOD_SANITIZE=address,undefined >$(SANITIZED).log 2>&1 || { cat $(SANITIZED).log; exit 1; }
	@$(BUILD) $(SANITIZED)

test-sanitized: test-sanitized-build  ## C++ tests under AddressSanitizer and UndefinedBehaviorSanitizer, short fuzzing
	@ctest --test-dir $(SANITIZED) --output-on-failure --no-tests=error -j 2

THREADED := station_tests station_hid_tests
test-threads: setup  ## loop, writer, telemetry under ThreadSanitizer
	@mkdir -p build
	@cmake -S . -B build/threads $(CMAKE_FLAGS) -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_FLAGS=-O1 -DHAPTICLOD_PYTHON=OFF \
	    -DCMAKE_CXX_COMPILER=$(SANITIZED_CXX) -DHAPTICLOD_SANITIZE=thread >build/threads.log 2>&1 || { cat build/threads.log; exit 1; }
	@$(BUILD) build/threads --target $(THREADED)
	@for test in $(THREADED); do build/threads/tests/$$test --gtest_brief=1 || exit 1; done

test-hidraw-vm: build  ## the station against a real kernel's hidraw in QEMU; skipped with one line where it cannot be had
	@scripts/test_device_vm uhid || [ $$? = 77 ]

test-usb-vm: build  ## the same on USB (vhci_hcd: usbhid, its endpoints, SET_REPORT, replug); downloads a kernel of 70 MB
	@scripts/test_device_vm usb || [ $$? = 77 ]

test-service-vm: build  ## the packed station as a systemd service in QEMU: installed, killed, with a device, stopped; fetches 250 MB
	@scripts/test_service_vm || [ $$? = 77 ]

test-circle: build  ## a hand recorded on the simulated device, a whole tuning for it, and its run: a minute
	@HAPTICLOD_WHOLE=1 $(BIN)/python -m pytest -q tests/test_recording_circle.py

test-python: build  ## Python tests
	@$(BIN)/python -m pytest -q -n auto --dist worksteal

lint: build  ## ruff, pyright, clang-format: nothing is changed
	@$(BIN)/ruff check $(PY_DIRS)
	@$(BIN)/ruff format --check $(PY_DIRS)
	@$(BIN)/pyright --warnings
	@$(if $(CPP_FILES),$(BIN)/clang-format --dry-run --Werror $(CPP_FILES))

format:  ## reformat Python and C++
	@$(BIN)/ruff check --fix --quiet $(PY_DIRS); $(BIN)/ruff format $(PY_DIRS)
	@$(if $(CPP_FILES),$(BIN)/clang-format -i $(CPP_FILES))

demo: product  ## from nothing to a running station: make a scan, tune it, run it
	@$(BIN)/python scripts/demo.py

bench: build  ## what a tick costs on 2.6 M triangles, against goals: some minutes
	@$(BIN)/python -m benchmarks.contact_table

bench-quick: build  ## the same on 100 k triangles
	@$(BIN)/python -m benchmarks.contact_table --quick

bench-station: product  ## wake-ups and computing of the loop apart, on the demo's bundle or BUNDLE=file [SECONDS_EACH=20]
	@$(BIN)/python -m benchmarks.bench_station $(if $(BUNDLE),--bundle="$(BUNDLE)") $(if $(SECONDS_EACH),--seconds="$(SECONDS_EACH)")

bench-open: build  ## from opening 2.6 M triangles, or BUNDLE=file, to the first tick: cold, warm, known
	@$(BIN)/python -m benchmarks.bench_open $(if $(BUNDLE),--bundle="$(BUNDLE)")

bench-static: product station-static  ## the static station against the dynamic one: make bench-static BUNDLE=file
	@$(BIN)/python -m benchmarks.bench_static --bundle "$(BUNDLE)"

TICKS ?= 100000000
RUNS ?= 1e7
FUZZ_TREE := build/fuzz-tree
FUZZ_TARGETS := trusted_keys motion bundle device_profile
# A tree of its own, optimised, with a renderer's scratch small. Under libFuzzer's "entropic" choice of inputs a profile took four times as long.
fuzz: setup  ## 10^7 mutated bundles, profiles, motions and key files under sanitizers: under two processor hours; make fuzz RUNS=1e6
	@command -v clang++ >/dev/null || { echo "make fuzz needs libFuzzer: apt-get install clang"; exit 1; }
	@mkdir -p build
	@cmake -S . -B $(FUZZ_TREE) $(CMAKE_FLAGS) -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_FLAGS=-O2 -DHAPTICLOD_PYTHON=OFF \
	    -DCMAKE_CXX_COMPILER=clang++ -DHAPTICLOD_SANITIZE=address,undefined -DHAPTICLOD_FUZZ=ON \
	    >$(FUZZ_TREE).log 2>&1 || { cat $(FUZZ_TREE).log; exit 1; }
	@$(BUILD) $(FUZZ_TREE) --target $(FUZZ_TARGETS:%=%_fuzz)
	@for target in $(FUZZ_TARGETS); do \
	    mkdir -p build/fuzz/$$target; words=runtime/fuzz/$$target.dict; \
	    ASAN_OPTIONS=quarantine_size_mb=16:malloc_context_size=4 $(FUZZ_TREE)/fuzz/$${target}_fuzz \
	        -runs=$$(printf %.0f $(RUNS)) -timeout=60 -max_len=16384 -entropic=0 -print_final_stats=1 $$([ ! -e $$words ] || echo -dict=$$words) \
	        -artifact_prefix=build/fuzz/$$target- build/fuzz/$$target runtime/fuzz/corpus/$$target || exit 1; \
	done

soak: build  ## random motions against the invariants of contact: TICKS=1e8, or make soak TICKS=1e6
	@$(RELEASE)/bench/soak $(TICKS)

DATA ?= $(or $(HAPTICLOD_DATA),../shared/data)
scans-table: product  ## every file of DATA/dirty and DATA/meshes checked and tuned, as a table; goes on where it was: [ONLY="part part"] [TOOL=file] [STATION=file] [KEEP=1]
	@$(BIN)/python -m benchmarks.scans_table --data "$(DATA)" $(if $(ONLY),--only $(ONLY)) $(if $(TOOL),--tool "$(TOOL)") $(if $(STATION),--station "$(STATION)") $(if $(KEEP),--keep)

soak-scans: TICKS := $(if $(filter command line,$(origin TICKS)),$(TICKS),1e6)
soak-scans: product  ## random hands on every scan of DATA, judged by geometry of its own: TICKS=1e6 each [ONLY="part part"] [SEED=0]
	@$(BIN)/python -m benchmarks.soak_scans --data "$(DATA)" --ticks $(TICKS) $(if $(ONLY),--only $(ONLY)) $(if $(SEED),--seed $(SEED))

full-mouth: product  ## the paper's head with mouth, 5.3 M triangles in 7 parts: bundled and run [TUNE=1-3] [SHARE=1.0] [FOLDER=kept] [JSON=out.json]
	@$(BIN)/python -m benchmarks.full_mouth $(if $(TUNE),--tune "$(TUNE)") $(if $(SHARE),--share "$(SHARE)") $(if $(FOLDER),--folder "$(FOLDER)") $(if $(JSON),--json "$(JSON)")

CASES ?= 2000
mutate-scans: product  ## CASES=2000 crops of scans with random faults: loaded, simplified and touched as the report says?
	@HAPTICLOD_MUTATIONS=$(CASES) $(BIN)/python -m pytest -q -n auto tests/test_scan_mutations.py

evaluate-surrogate: build  ## predictions against measurements: SCAN=file [MOTIONS="a.csv b.csv"] [TOOL=file] [CONFIGS=60] [HANDS=4] [JSON=out.json]
	@$(BIN)/python benchmarks/evaluate_surrogate.py $(if $(SCAN),--scan="$(SCAN)") $(if $(MOTIONS),--motions="$(MOTIONS)") $(if $(TOOL),--tool="$(TOOL)") $(if $(STATION),--station="$(STATION)") $(if $(CONFIGS),--configs="$(CONFIGS)") $(if $(HANDS),--hands="$(HANDS)") $(if $(SEED),--seed="$(SEED)") $(if $(UNIT),--unit="$(UNIT)") $(if $(JSON),--json="$(JSON)")

bench-tuners: build  ## our tuner against Optuna TPE, CMA-ES, random search, a grid: SCAN=file [TOOL=file] [EVALUATIONS=400] [SECONDS_EACH=0] [BUDGET=us] [JSON=out.json]
	@$(BIN)/python -c "import cmaes, optuna" 2>/dev/null || $(BIN)/pip install -q --no-build-isolation -e '.[bench]'
	@$(BIN)/python -m benchmarks.bench_tuners $(if $(SCAN),--scan="$(SCAN)") $(if $(MOTIONS),--motions="$(MOTIONS)") $(if $(TOOL),--tool="$(TOOL)") $(if $(STATION),--station="$(STATION)") $(if $(BUDGET),--budget-us="$(BUDGET)") $(if $(EVALUATIONS),--evaluations="$(EVALUATIONS)") $(if $(SECONDS_EACH),--seconds="$(SECONDS_EACH)") $(if $(SEED),--seed="$(SEED)") $(if $(UNIT),--unit="$(UNIT)") $(if $(JSON),--json="$(JSON)")

optimiser-cases: build  ## our search against SLSQP with the same gradients, on surrogates: [BUDGETS=4] [STARTS=4] [SCANS="a.ply b.ply"] [JSON=out.json]
	@$(BIN)/python -m benchmarks.optimiser_cases $(if $(BUDGETS),--budgets="$(BUDGETS)") $(if $(STARTS),--starts="$(STARTS)") $(if $(SCANS),--scans="$(SCANS)") $(if $(JSON),--json="$(JSON)")

clean:  ## remove build products (keeps .venv)
	@rm -rf build dist hapticlod/_runtime.*
