"""Shared fixtures: the optional data folder, its scripts, and quiet plotting."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

# The kernels give the same bits for any number of threads; more than two only slow the other jobs down.
os.environ.setdefault("RAYON_NUM_THREADS", str(min(os.cpu_count() or 1, 2)))
os.environ["MPLBACKEND"] = "Agg"

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Images, curves and scripts beside the checkout; tests that need them are skipped without it."""
    if not (DATA / "score.py").is_file():
        pytest.skip(f"needs the data folder {DATA.relative_to(ROOT.parent)} beside the checkout")
    return DATA


@pytest.fixture(scope="session")
def data_script(data_folder: Path) -> Callable[[str], ModuleType]:
    """One of the data folder's scripts as a module: make_clouds, make_images or score."""

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"data_{name}", data_folder / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20050601)
