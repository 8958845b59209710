# make demo   a picture from a fresh machine: sets up .venv, grows grass of the bundled generator on the bundled mesh
# make test   sets up all that the tests need, and passes them
# make test-all   the same with the slow tests, which take minutes or repeat what others test
# make test-gpu   the hard cases, a training of `tiny` and benchmarks, on the GPU or TPU that JAX finds
# make docs   the documentation as a site, site/index.html
# make gallery   the pictures of docs/index.md anew
# make blender   the separate environment that `mesoshell dataset render` calls
# make nojax   an environment without JAX, in which path tracing is tested

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
# Blender's module needs Python 3.11; with another one its tests say that they are skipped
BLENDER := $(shell $(PYTHON) -c 'import sys; print("blender" * (sys.version_info[:2] == (3, 11)))')

# What `mesoshell render --engine mitsuba` imports
WITHOUT_JAX := numpy scipy jaxtyping trimesh networkx libigl xatlas pillow OpenEXR tyro rich mitsuba karellen-llvm-core

# rules of one environment never run at once; what may, runs in a make of its own
ifeq ($(MAKELEVEL),0)
.NOTPARALLEL:
endif

.PHONY: demo test test-all test-gpu lint docs gallery blender nojax clean

demo: .venv/installed
	$(BIN)/mesoshell render src/mesoshell/assets/spot.obj --material lawn --scale 0.15 --thickness 0.1 --camera 1.5 0.9 -2.4 0 0.05 0.15 40 --out out/demo.png

test: .venv/installed-dev
	+$(MAKE) -j 2 lint docs $(BLENDER) nojax
	$(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder --durations=25

test-all: .venv/installed-dev
	+$(MAKE) -j 2 lint docs $(BLENDER) nojax
	$(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder --durations=10 -m "slow or not slow"

test-gpu: .venv/installed-dev
	@$(BIN)/python -m benchmarks.accelerator --find
	$(BIN)/python -m pytest tests/stability -m "slow or not slow"
	$(BIN)/python -m benchmarks.accelerator
	$(BIN)/python -m benchmarks.precision
	$(BIN)/python -m benchmarks.decoder
	$(BIN)/python -m benchmarks.render
	$(BIN)/python -m benchmarks.generator

lint: .venv/installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports
	$(BIN)/pyright

docs: .venv/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

gallery: .venv/installed-dev
	$(BIN)/python docs/gallery.py

blender: data_gen/.venv/installed

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml packages/materials/pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e . -e packages/materials
	touch $@

.venv/installed-dev: pyproject.toml packages/materials/pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]' -e packages/materials
	touch $@ .venv/installed

data_gen/.venv/installed: data_gen/requirements.txt
	$(PYTHON) -m venv data_gen/.venv
	data_gen/.venv/bin/pip install -q --disable-pip-version-check -r data_gen/requirements.txt
	touch $@

nojax: .venv-nojax/installed

.venv-nojax/installed: pyproject.toml packages/materials/pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-nojax
	.venv-nojax/bin/pip install -q --disable-pip-version-check -c constraints.txt $(WITHOUT_JAX)
	.venv-nojax/bin/pip install -q --disable-pip-version-check --no-deps -e . -e packages/materials
	touch $@

clean:
	rm -rf .venv .venv-nojax out build site *.egg-info
