"""Model files of fields on grids: the same bits come back, and anything else is refused with one clear error."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import tspline
from tspline.errors import FileFormatError, InvalidArgumentError
from tspline.grid import Grid, GridField
from tspline.grid.grid_file import NAMES

RANDOM = settings(max_examples=20, deadline=None, derandomize=True)
HOSTILE = settings(max_examples=150, deadline=None, derandomize=True)
Members = dict[str, NDArray[Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("grids")


@pytest.fixture(scope="module")
def model(folder: Path) -> GridField:
    grid = Grid((30, 21), (0.5, 0.25), (1.0, -2.0))
    middle = grid.bounds.mean(axis=0)
    field = GridField(
        grid, np.linalg.norm(grid.nodes() - middle, axis=-1) - 1.5, band=0.6, metadata={"made by": ["a test", 1.5]}
    )
    field.save(folder / "grid.tsp.npz")
    return field


def members(path: Path) -> Members:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def assert_same(a: GridField, b: GridField) -> None:
    assert a.grid == b.grid
    assert a.band == b.band
    assert a.blocks.places.tobytes() == b.blocks.places.tobytes()
    assert a.blocks.values.tobytes() == b.blocks.values.tobytes()
    assert a.blocks.inside.tobytes() == b.blocks.inside.tobytes()
    assert a.metadata == b.metadata


@RANDOM
@given(st.integers(0, 10_000), st.sampled_from([2, 3]), st.sampled_from([None, 0.3]))
def test_fields_come_back_to_the_bit(folder: Path, seed: int, dim: int, band: float | None) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 30, dim).tolist())
    values = rng.normal(size=shape)
    values.flat[:4] = [-0.0, 5e-324, -1.7976931348623157e308, 0.1 + 0.2]
    field = GridField(Grid(shape, rng.uniform(0.1, 2.0, dim), rng.normal(size=dim)), values, band=band)
    path = folder / "random.tsp.npz"
    field.save(path)
    again = tspline.load(path)
    assert isinstance(again, GridField)
    assert_same(again, field)
    first = path.read_bytes()
    again.save(path)
    assert path.read_bytes() == first


def test_metadata_come_back(model: GridField, folder: Path) -> None:
    again = tspline.load(folder / "grid.tsp.npz")
    assert isinstance(again, GridField)
    assert_same(again, model)
    bad = GridField(model.grid, model.blocks, metadata={"a": np.nan})
    with pytest.raises(InvalidArgumentError, match=r"^metadata"):
        bad.save(folder / "bad.tsp.npz")
    assert not (folder / "bad.tsp.npz").exists()


def test_the_command_tells_of_grids(model: GridField, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cli.main import main

    assert main(["info", str(folder / "grid.tsp.npz"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["shape"] == [30, 21]
    assert told["spacing"] == [0.5, 0.25]
    assert told["num_coefficients"] == model.num_coefficients
    assert told["components"] == model.num_components() == 1
    assert main(["info", str(folder / "grid.tsp.npz")]) == 0
    assert "30 x 21" in capsys.readouterr().out


def refused(path: Path) -> str:
    with pytest.raises(FileFormatError) as caught:
        tspline.load(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


HUGE = 1 << 19


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (lambda m: m.pop("far"), "missing, unknown or repeated"),
        (lambda m: m.update(extra=np.zeros(1)), "missing, unknown or repeated"),
        (lambda m: m.update(kind=np.frombuffer(b"mesh", np.uint8)), "kind 'mesh'"),
        (lambda m: m.update(sign_convention=np.frombuffer(b"other", np.uint8)), "another sign convention"),
        (lambda m: m.update(version=np.array(2)), "version 2"),
        (lambda m: m.update(shape=np.array([30])), "at most 8 bytes"),
        (lambda m: m.update(shape=np.array([30, 1])), "no grid"),
        (lambda m: m.update(shape=np.array([HUGE, HUGE])), "at most 268435456"),
        (lambda m: m.update(shape=np.array([31, 60])), "inside"),
        (lambda m: m.update(shape=np.array([30.0, 21.0])), "shape of type"),
        (lambda m: m.update(spacing=np.array([0.5, -1.0])), "no grid"),
        (lambda m: m.update(origin=np.array([np.nan, 0.0])), "no grid"),
        (lambda m: m.update(far=np.array(-1.0)), "no field on a grid"),
        (lambda m: m.update(far=np.array(np.nan)), "no field on a grid"),
        (lambda m: m.update(far=np.array(np.inf)), "no field on a grid"),
        (lambda m: m.update(places=m["places"] + np.uint32(1)), "no field on a grid"),
        (lambda m: m.update(places=np.zeros_like(m["places"])), "twice"),
        (lambda m: m.update(places=m["places"][:, :1]), "columns"),
        (lambda m: m.update(places=m["places"][:-1]), "at most"),
        (lambda m: m.update(values=m["values"][:, :-1]), "values"),
        (lambda m: m.update(values=m["values"].astype(np.float32)), "values of type"),
        (lambda m: m.update(values=m["values"] * np.nan), "NaN"),
        (lambda m: m.update(values=m["values"] * np.inf), "no field on a grid"),
        (lambda m: m.update(inside=m["inside"][:-1]), "inside"),
        (lambda m: m.update(inside=m["inside"] | np.uint8(1)), "beyond the grid"),
        (lambda m: m.update(metadata=np.frombuffer(b"[1]", np.uint8)), "metadata"),
        (lambda m: m.update(metadata=np.frombuffer(b"{", np.uint8)), "metadata"),
    ],
)
def test_what_contradicts_itself_is_refused(
    model: GridField, folder: Path, change: Callable[[Members], object], wrong: str
) -> None:
    arrays = members(folder / "grid.tsp.npz")
    assert sorted(arrays) == sorted(NAMES)
    assert json.loads(arrays["metadata"].tobytes()) == model.metadata
    change(arrays)
    path = folder / "hostile.npz"
    np.savez(path, **arrays)
    assert wrong in refused(path)


@HOSTILE
@given(data=st.data())
def test_damaged_files_are_refused_or_read(model: GridField, folder: Path, data: st.DataObject) -> None:
    good = (folder / "grid.tsp.npz").read_bytes()
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(good)) if data.draw(st.booleans()) else st.just(len(good)))
    path = folder / "damaged.npz"
    path.write_bytes(bytes(damaged[:end]))
    try:
        loaded = tspline.load(path)
    except FileFormatError as error:
        loaded = None
        text = str(error)
    if loaded is None:
        assert text.startswith(str(path))
        return
    assert isinstance(loaded, GridField)
    assert np.isfinite(loaded.values).all()
