# make demo    segment an image, fit points in the plane and in space, pictures in demo-out/
# make test    everything that is checked before a change goes in
#
# Both keep to one virtual environment, .venv, made from $(PYTHON) and renewed only when pyproject.toml, a Cargo file
# or a Rust source changes. Needs Python >= 3.10 and a Rust toolchain; fetches from PyPI and crates.io only.

PYTHON ?= python3
VENV   := .venv
RUN    := $(VENV)/bin/python
PIP    := $(RUN) -m pip --disable-pip-version-check
CODE   := tspline recon segment cli tests examples benchmarks
INPUTS := pyproject.toml Cargo.toml $(wildcard Cargo.lock) $(wildcard core/*/Cargo.toml) \
          $(shell find core -name '*.rs' 2>/dev/null)

# pip looks for maturin there when the build is not isolated.
export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test lint rust-tools types cargo-test python-test wheel peers bench pictures install clean

help:
	@echo 'make demo         install into .venv and run the demonstration (demo-out/)'
	@echo 'make test         lint, types, cargo-test, python-test'
	@echo 'make lint         cargo fmt, clippy, ruff'
	@echo 'make types        mypy, and the stub against the compiled module'
	@echo 'make cargo-test   tests of the Rust kernels'
	@echo 'make python-test  pytest'
	@echo 'make wheel        a release wheel in dist/'
	@echo 'make peers        what the benchmarks compare with, minutes'
	@echo 'make bench        every benchmark beside its peers; minutes'
	@echo 'make pictures     run the demonstration and renew the pictures of README.md'
	@echo 'make install      only the environment'
	@echo 'make clean        remove what these targets made'

demo: $(VENV)/installed
	$(VENV)/bin/tspline demo --out demo-out --force

# README's pictures are the demonstration's own, with a palette of 128 colours to keep the repository small.
pictures: demo
	mkdir -p docs/images
	$(RUN) -c 'from PIL import Image; import sys; \
	    [Image.open(a).convert("RGB").quantize(128, dither=0).save(b, optimize=True) \
	     for a, b in zip(sys.argv[1::2], sys.argv[2::2])]' \
	    demo-out/coins_figure.png docs/images/demo.png demo-out/ampersand_figure.png docs/images/demo_points.png \
	    demo-out/knot_figure.png docs/images/demo_surface.png

test: lint types cargo-test python-test

lint: $(VENV)/installed-test rust-tools
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	$(RUN) -m ruff check $(CODE)
	$(RUN) -m ruff format --check $(CODE)

# A minimal Rust profile comes without the formatter and the linter.
rust-tools:
	@cargo fmt --version >/dev/null 2>&1 || rustup component add rustfmt
	@cargo clippy --version >/dev/null 2>&1 || rustup component add clippy

types: $(VENV)/installed-test
	$(RUN) -m mypy
	$(RUN) -m mypy.stubtest tspline._core

# The bindings link against an interpreter only when it loads them: the Python tests cover them.
cargo-test:
	cargo test --workspace --exclude tspline-python

python-test: $(VENV)/installed-test
	$(RUN) -m pytest

wheel: $(VENV)/installed
	rm -rf dist
	$(PIP) wheel --no-build-isolation --no-deps --wheel-dir dist .

# The peers are installed by themselves: those that come as sources bring build tools of their own.
peers: $(VENV)/installed
	$(RUN) -c 'from importlib.metadata import requires; \
	    print(*(r.split(";")[0] for r in requires("tspline") if "benchmarks" in r), sep="\n")' > $(VENV)/peers.txt
	$(PIP) install --quiet --requirement $(VENV)/peers.txt

bench: peers
	for script in kernels curves paper_examples images regions natural subpixel resources scaling grid_solver cross_check surfaces; do \
	    $(RUN) benchmarks/$$script.py || exit 1; done

install: $(VENV)/installed

# pip and maturin first: the build then runs with this environment's maturin, and finds Cargo's results again.
$(VENV)/tools: pyproject.toml
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(RUN) -c 'import sys; sys.version_info >= (3, 10) or sys.exit("Python 3.10 or later is needed: make PYTHON=...")'
	$(PIP) install --quiet --upgrade pip 'maturin>=1.7,<2'
	touch $@

$(VENV)/installed: $(VENV)/tools $(INPUTS)
	$(PIP) install --quiet --no-build-isolation --editable .
	touch $@

$(VENV)/installed-test: $(VENV)/tools $(INPUTS)
	$(PIP) install --quiet --no-build-isolation --editable '.[test]'
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) target dist build demo-out tspline/_core*.so tspline/_core*.pyd
	rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find $(CODE) -name __pycache__ -prune -exec rm -rf {} +
