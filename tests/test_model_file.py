"""Model files: the same bits come back, and anything else is refused with one clear error."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles.random_mesh import random_mesh

from tspline.errors import FileFormatError, InvalidArgumentError
from tspline.mesh import TREE_SIDE, TMesh
from tspline.model_file import NAMES, load, save
from tspline.spline import TSpline

RANDOM = settings(max_examples=15, deadline=None, derandomize=True)
HOSTILE = settings(max_examples=150, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10_000)
DIMS = st.sampled_from([2, 3])
Members = dict[str, NDArray[Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("models")


@pytest.fixture(scope="module")
def model(folder: Path) -> TSpline:
    """A small spline, saved as model.tsp.npz."""
    mesh = random_mesh(1, 2, rounds=1)
    c = np.random.default_rng(1).normal(size=mesh.num_functions)
    spline = TSpline(mesh, c, {"made by": "a test", "steps": [1, 2.5, None, True]})
    save(spline, folder / "model.tsp.npz")
    return spline


def assert_same(a: TSpline, b: TSpline) -> None:
    """Equal to the bit: NaN-free numbers compared as bytes, so that -0.0 is not 0.0."""
    for name in ("corners", "levels", "anchors", "local_knots"):
        np.testing.assert_array_equal(getattr(a.mesh.core, name), getattr(b.mesh.core, name))
    assert a.coefficients.tobytes() == b.coefficients.tobytes()
    assert a.bounds.tobytes() == b.bounds.tobytes()
    assert a.metadata == b.metadata


def refused(path: Path) -> str:
    with pytest.raises(FileFormatError) as caught:
        load(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    assert "accepted is" in text
    return text


def members(path: Path) -> Members:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


@RANDOM
@given(SEEDS, DIMS)
def test_models_come_back_to_the_bit(folder: Path, seed: int, dim: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = random_mesh(seed, dim)
    low = rng.normal(size=dim)
    mesh = mesh.rescaled([low, low + rng.uniform(0.1, 10)])
    c = rng.normal(size=mesh.num_functions) * 10.0 ** rng.integers(-300, 300, mesh.num_functions)
    c[:4] = [-0.0, 5e-324, -1.7976931348623157e308, 0.1 + 0.2]
    spline = TSpline(mesh, c)
    path = folder / "random.tsp.npz"
    spline.save(path)
    assert_same(load(path), spline)
    first = path.read_bytes()
    load(path).save(path)
    assert path.read_bytes() == first


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@RANDOM
@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_metadata_come_back(folder: Path, metadata: dict[str, Any]) -> None:
    mesh = TMesh.uniform([[0, 0], [1, 1]], 0)
    save(TSpline(mesh, np.zeros(16), metadata), folder / "metadata.npz")
    assert load(folder / "metadata.npz").metadata == metadata


def deep(levels: int) -> list[Any]:
    nested: list[Any] = []
    for _ in range(levels):
        nested = [nested]
    return nested


@pytest.mark.parametrize(
    "metadata",
    [
        {"a": np.nan},
        {"a": [np.inf]},
        {"a": np.arange(3)},
        {"a": {1, 2}},
        {"a": b"bytes"},
        {1: "a"},
        {"a": [{None: 1}]},
        {"a": deep(100_000)},
    ],
)
def test_metadata_that_json_cannot_hold_are_refused(tmp_path: Path, metadata: dict[str, Any]) -> None:
    spline = TSpline(TMesh.uniform([[0, 0], [1, 1]], 0), np.zeros(16), metadata)
    with pytest.raises(InvalidArgumentError, match=r"^metadata: found"):
        save(spline, tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())


def test_files_are_named_as_asked_and_replaced_whole(tmp_path: Path, model: TSpline) -> None:
    path = tmp_path / "any name"
    path.write_text("old")
    save(model, path)
    assert_same(load(path), model)
    assert [p.name for p in tmp_path.iterdir()] == ["any name"]
    assert_same(load(str(path)), model)


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path, model: TSpline) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        save(model, tmp_path / "missing" / "a.npz")
    assert caught.value.filename == str(tmp_path / "missing" / "a.npz")
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        save(model, tmp_path / "folder")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


def test_files_that_cannot_be_opened_are_errors_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "missing.tsp.npz")
    with pytest.raises(IsADirectoryError):
        load(tmp_path)


def test_numpy_reads_the_file_without_pickle(folder: Path, model: TSpline) -> None:
    arrays = members(folder / "model.tsp.npz")
    assert sorted(arrays) == sorted(NAMES)
    assert arrays["format"].tobytes() == b"tspline-model"
    assert arrays["version"] == 1
    assert b"f < 0 inside" in arrays["sign_convention"].tobytes()
    np.testing.assert_array_equal(arrays["corners"], model.mesh.core.corners)
    assert {name: str(array.dtype) for name, array in arrays.items() if name in ("corners", "levels")} == {
        "corners": "uint32",
        "levels": "uint8",
    }


def text(value: str) -> NDArray[np.uint8]:
    return np.frombuffer(value.encode(), dtype=np.uint8)


def changed(name: str, index: Any, value: Any) -> Callable[[Members], None]:
    """A change of one number."""

    def change(arrays: Members) -> None:
        arrays[name][index] = value

    return change


def put(name: str, array: Any) -> Callable[[Members], None]:
    """A member replaced, or added."""
    return lambda arrays: arrays.__setitem__(name, np.asarray(array))


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (changed("local_knots", (5, 0, 2), 7), "local knots"),
        (changed("local_knots", (0, 1, 4), TREE_SIDE - 1), "local knots"),
        (changed("coefficients", 3, np.nan), "NaN or infinite"),
        (changed("coefficients", 0, -np.inf), "NaN or infinite"),
        (changed("levels", 0, 200), "no T-mesh"),
        (changed("levels", 0, 0), "no T-mesh"),
        (changed("corners", (0, 0), 1), "no T-mesh"),
        (changed("corners", (0, 0), TREE_SIDE), "no T-mesh"),
        (changed("corners", (0, 0), 2**32 - 1), "no T-mesh"),
        (changed("bounds", (1, 0), np.nan), "no T-mesh"),
        (changed("bounds", (1, 0), 1e300), "no T-mesh"),
        (put("bounds", [[1.0, 1.0], [0.0, 0.0]]), "no T-mesh"),
        (put("bounds", np.zeros((2, 3))), "bounds"),
        (put("dim", 3), "bounds"),
        (put("dim", -1), "dim -1"),
        (put("dim", 2.0), "dim of type float64"),
        (put("version", 2), "version 2"),
        (put("version", [1]), "version"),
        (put("format", text("tspline-mesh")), "no T-spline model"),
        (put("format", text("\0" * 200)), "format"),
        (put("format", np.array([255, 254], dtype=np.uint8)), "no text"),
        (put("sign_convention", text("f > 0 inside")), "sign convention"),
        (put("metadata", text("[1]")), "metadata of type list"),
        (put("metadata", text("{")), "no JSON"),
        (put("metadata", text('{"a": NaN}')), "no JSON"),
        (put("metadata", text("[" * 100_000)), "no JSON"),
        (put("metadata", text("9" * 5000)), "metadata"),
        (put("levels", np.zeros(0, dtype=np.uint8)), "corners"),
        (put("levels", np.zeros((2, 2), dtype=np.uint8)), "levels"),
        (put("corners", np.zeros((3, 2), dtype=np.int64)), "corners"),
        (put("coefficients", np.zeros(3)), "coefficients"),
        (put("coefficients", np.zeros(100_000)), "coefficients"),
        (put("local_knots", np.zeros((1, 2, 5), dtype=np.uint32)), "local_knots"),
        (put("extra", 1), "unknown"),
        (lambda arrays: arrays.pop("metadata"), "missing"),
        (lambda arrays: arrays.pop("format"), "no T-spline model"),
        (lambda arrays: arrays.clear(), "no T-spline model"),
    ],
)
def test_changed_models_are_refused(
    tmp_path: Path, folder: Path, model: TSpline, change: Callable[[Members], object], wrong: str
) -> None:
    del model  # has written the file
    arrays = members(folder / "model.tsp.npz")
    change(arrays)
    path = tmp_path / "changed.tsp.npz"
    np.savez(path, **arrays)
    assert wrong in refused(path)


def test_pickled_objects_are_never_loaded(tmp_path: Path, folder: Path, model: TSpline) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "executed"),)

    arrays = members(folder / "model.tsp.npz")
    arrays["coefficients"] = np.array([Trap()] * model.num_coefficients, dtype=object)
    path = tmp_path / "trap.tsp.npz"
    np.savez(path, **arrays)
    assert "object" in refused(path)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("name", sorted(NAMES))
@pytest.mark.parametrize("shape", ["(1099511627776,)", "(4000000000, 2)", "(-1,)", "(2**40,)", "()"])
def test_headers_that_promise_too_much_are_refused(
    tmp_path: Path, folder: Path, model: TSpline, name: str, shape: str
) -> None:
    del model
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    lie = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + b"\0" * 100
    path = tmp_path / "lie.tsp.npz"
    with zipfile.ZipFile(folder / "model.tsp.npz") as source, zipfile.ZipFile(path, "w") as sink:
        for info in source.infolist():
            sink.writestr(info.filename, lie if info.filename == f"{name}.npy" else source.read(info))
    refused(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, folder: Path, model: TSpline) -> None:
    del model
    arrays = members(folder / "model.tsp.npz")
    path = tmp_path / "bomb.tsp.npz"
    for name in ("coefficients", "metadata", "levels", "local_knots"):
        bomb = np.zeros(1 << 26, dtype=np.uint8)
        np.savez_compressed(path, **(arrays | {name: bomb}))
        refused(path)


@HOSTILE
@given(st.binary(max_size=400))
def test_arbitrary_bytes_are_refused(folder: Path, data: bytes) -> None:
    path = folder / "bytes.tsp.npz"
    path.write_bytes(data)
    refused(path)


@HOSTILE
@given(st.sampled_from(NAMES), st.binary(max_size=200))
def test_arbitrary_bytes_for_a_member_are_refused(folder: Path, model: TSpline, name: str, data: bytes) -> None:
    del model
    path = folder / "member.tsp.npz"
    with zipfile.ZipFile(folder / "model.tsp.npz") as source, zipfile.ZipFile(path, "w") as sink:
        for info in source.infolist():
            sink.writestr(info.filename, data if info.filename == f"{name}.npy" else source.read(info))
    refused(path)


@HOSTILE
@given(st.floats(0, 1, exclude_max=True))
def test_truncated_files_are_refused(folder: Path, model: TSpline, share: float) -> None:
    del model
    data = (folder / "model.tsp.npz").read_bytes()
    path = folder / "short.tsp.npz"
    path.write_bytes(data[: int(share * len(data))])
    refused(path)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.floats(0, 1, exclude_max=True), st.integers(0, 7), st.booleans())
def test_a_flipped_bit_is_refused_or_changes_nothing(
    folder: Path, model: TSpline, share: float, bit: int, in_directory: bool
) -> None:
    data = bytearray((folder / "model.tsp.npz").read_bytes())
    # Flips in the data are found by checksums; those in the archive's directory need the reader's own care.
    first = data.index(b"PK\x01\x02") if in_directory else 0
    data[first + int(share * (len(data) - first))] ^= 1 << bit
    path = folder / "flipped.tsp.npz"
    path.write_bytes(data)
    try:
        loaded = load(path)
    except FileFormatError:
        refused(path)
    else:
        assert_same(loaded, model)


def test_streams_of_other_formats_are_refused(tmp_path: Path) -> None:
    points = tmp_path / "points.npz"
    np.savez(points, points=np.zeros((3, 2)))
    assert "no T-spline model" in refused(points)
    single = tmp_path / "single.npy"
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    single.write_bytes(stream.getvalue())
    refused(single)
