# make demo [IMAGES=folder] [OUTPUT=folder] [MEMORY=8GB]   reconstructs your photographs, or a synthetic scene
# make test                                                 builds, then runs ctest and pytest
# make lint                                                 the checks of the style
#
# The first run installs what is missing (third_party/debian-packages.txt) and makes .venv; later runs do
# only what has changed.

SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check --quiet
MEMORY ?= 8GB
OUTPUT ?= demo/$(if $(IMAGES),$(shell basename "$(IMAGES)"),scene)

SOURCES := $(shell find cpp python -name '*.cc' -o -name '*.h' -o -name 'CMakeLists.txt' \
             -o -name '*.py' -o -name '*.pyi' -o -name '*.css' -o -name '*.toml') CMakeLists.txt pyproject.toml
CPP_FILES = $(shell find cpp tests/cpp benchmarks -name '*.cc' -o -name '*.h')

.PHONY: demo test lint clean
.DELETE_ON_ERROR:

demo: $(VENV)/.installed
ifdef IMAGES
	$(BIN)/sirpy reconstruct "$(IMAGES)" --output "$(OUTPUT)" --memory $(MEMORY)
else
	$(BIN)/sirpy demo --output "$(OUTPUT)" --memory $(MEMORY)
endif

test: $(VENV)/.installed $(VENV)/.test-packages $(VENV)/.test-tools
	cmake -S . -B build/cpp -DCMAKE_BUILD_TYPE=Release -DSIRPY_TESTS=ON -DSIRPY_PYTHON=OFF
	cmake --build build/cpp --parallel $$(nproc)
	ctest --test-dir build/cpp --output-on-failure
	$(BIN)/python -m pytest

lint: $(VENV)/.installed $(VENV)/.test-tools $(VENV)/.lint-tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(CPP_FILES)

$(VENV)/.made: third_party/debian-packages.txt
	third_party/install_debian_packages.sh build
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; say which with make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

# The compiled parts are kept in build/, so that a change rebuilds only what depends on it.
$(VENV)/.installed: $(VENV)/.made $(SOURCES)
	@echo 'Building sirpy: some minutes the first time'
	$(PIP) ".[tiles3d]"
	@touch $@

$(VENV)/.test-packages: $(VENV)/.made third_party/debian-packages.txt
	third_party/install_debian_packages.sh test
	@touch $@

# The tools of an extra of pyproject.toml, without building the package again.
$(VENV)/.%-tools: $(VENV)/.made pyproject.toml
	$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["$*"], sep="\n")' > $(VENV)/$*.txt
	$(PIP) -r $(VENV)/$*.txt
	@touch $@

clean:
	rm -rf build $(VENV)
