"""Files of points: every format against what was written, and nothing but `FileFormatError` for bad bytes."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.point_file import POINT_ENDINGS, parse_points, read_points
from tspline.errors import FileFormatError

POINTS = np.array([[0.5, -1.25], [1e-3, 2.0], [3.0, 4e5]])
SPACE = np.array([[0.5, -1.25, 1.0], [1e-3, 2.0, -7.5], [3.0, 4e5, 0.0]])


def rejected(data: bytes, ending: str | None = None) -> str:
    with pytest.raises(FileFormatError) as caught:
        parse_points(data, "cloud", ending)
    text = str(caught.value)
    assert text.startswith("cloud")
    assert "\n" not in text
    assert "accepted is" in text
    return text


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


@pytest.mark.parametrize("delimiter", [" ", ",", ", ", "\t", ";", "   "])
@pytest.mark.parametrize("points", [POINTS, SPACE])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_text_gives_the_written_numbers(delimiter: str, points: np.ndarray, newline: str) -> None:
    text = newline.join(delimiter.join(repr(float(x)) for x in row) for row in points)
    np.testing.assert_array_equal(parse_points(text.encode(), "cloud"), points)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("# made by hand\n\n1 2\n3 4 # the last\n", [[1, 2], [3, 4]]),
        ("\ufeffx,y\n1,2\n3,4\n", [[1, 2], [3, 4]]),
        ("id,y,x\n7,1,2\n8,3,4\n", [[2, 1], [4, 3]]),
        ('"X";"Y"\n1,5;2,5\n3,5;4,5\n', [[1.5, 2.5], [3.5, 4.5]]),
        ("2\n1 2\n3 4\n", [[1, 2], [3, 4]]),
        ("1 2 3 0 0 1\n4 5 6 0 1 0\n", [[1, 2, 3], [4, 5, 6]]),
        ("# head\nd 0 0 0\np 1 2 3\np 4 5 6\n", [[1, 2, 3], [4, 5, 6]]),
        ("// a\n% b\n1 2\n", [[1, 2]]),
    ],
)
def test_the_ways_that_text_is_written(text: str, expected: list[list[float]]) -> None:
    np.testing.assert_array_equal(parse_points(text.encode(), "cloud"), np.array(expected, dtype=float))


def test_obj_gives_its_vertices() -> None:
    text = b"# o\nmtllib a.mtl\no thing\nv 1 2 3\nv 4 5 6 1.0\nvn 0 0 1\nvt 0 0\nf 1 2 1\n"
    np.testing.assert_array_equal(parse_points(text, "cloud", ".obj"), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_agrees_with_trimesh(encoding: str) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    data = mesh.export(file_type="ply", encoding=encoding)
    expected = trimesh.load(io.BytesIO(data), file_type="ply", process=False).vertices
    np.testing.assert_allclose(parse_points(data, "cloud"), expected, rtol=1e-7)


def test_ply_big_endian_in_the_plane_after_another_element() -> None:
    head = (
        b"ply\nformat binary_big_endian 1.0\nelement camera 1\nproperty float f\n"
        b"element vertex 3\nproperty double x\nproperty uchar q\nproperty double y\nend_header\n"
    )
    rows = np.zeros(3, dtype=[("x", ">f8"), ("q", "u1"), ("y", ">f8")])
    rows["x"], rows["y"] = POINTS.T
    data = head + np.array([1.0], dtype=">f4").tobytes() + rows.tobytes()
    np.testing.assert_array_equal(parse_points(data, "cloud"), POINTS)
    assert "data for 2" in rejected(data[:-1])


@pytest.mark.parametrize("points", [POINTS, SPACE.astype(np.float32), SPACE.astype(np.int16), POINTS.T.copy().T])
def test_numpy_files(points: np.ndarray) -> None:
    np.testing.assert_array_equal(parse_points(npy(points), "cloud"), points.astype(float))
    np.testing.assert_array_equal(parse_points(npz(points=points, other=np.zeros(3)), "cloud"), points.astype(float))
    np.testing.assert_array_equal(parse_points(npz(anything=points), "cloud"), points.astype(float))


@pytest.mark.parametrize(
    ("data", "ending", "told"),
    [
        (b"", None, "empty"),
        (b"\n\n# only a comment\n", None, "no points"),
        (b"1 2\n3 4 5\n", None, "cloud:2: found"[:8]),
        (b"1 2\n3 x\n", None, "cloud:2"),
        (b"1 2\n3 nan\n", None, "nan"),
        (b"1 2\n3 1e999\n", None, "inf"),
        (b"1 2 3 4\n", None, "4 numbers"),
        (b"Dear reader, this is a letter.\nIt has no numbers.\n", None, "cloud:1"),
        (b"3\n1 2\n3 4\n", None, "announces 3 points, found 2"),
        (b"1_0 2\n", None, "1_0"),
        (b"a,b,c,d\n1,2,3,4\n", None, "columns named x, y"),
        (b"1 2\n\xff\xfe\n", None, "cloud:2"),
        (bytes(range(256)), None, "binary"),
        (b"d 0 0 0\n", None, "begin with d"),
        (b"vn 0 0 1\n", ".obj", "no points"),
        (b"ply\nformat ascii 1.0\n", None, "header"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nend_header\n1 2\n",
            None,
            "for 1",
        ),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", None, "properties"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999999\nproperty double x\n"
            b"property double y\nend_header\n0123456789abcdef",
            None,
            "data for 1",
        ),
        (npy(np.zeros((3, 2)))[:-8], None, "found 40"),
        (npy(np.zeros((3, 4))), None, "shape (3, 4)"),
        (npy(np.zeros(3)), None, "shape (3,)"),
        (npy(np.zeros((2, 2), dtype=complex)), None, "complex"),
        (npy(np.zeros((0, 2))), None, "no points"),
        (npz(a=POINTS, b=POINTS), None, "a, b"),
        (npz(points=POINTS)[:-30], None, "archive"),
        (
            b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 2), }",
            None,
            "cloud",
        ),
    ],
)
def test_bad_files_are_named_with_what_was_found(data: bytes, ending: str | None, told: str) -> None:
    assert told in rejected(data, ending)


def test_nothing_is_unpickled() -> None:
    array = np.array([[{"a": 1}, None]], dtype=object)
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    assert "object" in rejected(stream.getvalue())


def test_archive_that_inflates_is_not_inflated() -> None:
    """An archive whose directory and array header disagree is refused before its data are read."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        head = npy(np.zeros((2, 2)))[:128]
        archive.writestr("points.npy", head + bytes(50_000_000))
    assert "found 50000000" in rejected(stream.getvalue())


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=400), st.sampled_from([None, *POINT_ENDINGS]))
def test_arbitrary_bytes(data: bytes, ending: str | None) -> None:
    try:
        points = parse_points(data, "cloud", ending)
    except FileFormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 - the error is one of two good outcomes
    else:
        assert np.isfinite(points).all()


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files(data: st.DataObject) -> None:
    sphere = trimesh.creation.box()
    whole = data.draw(
        st.sampled_from(
            [
                npy(POINTS),
                npz(points=POINTS),
                sphere.export(file_type="ply"),
                sphere.export(file_type="ply", encoding="ascii"),
                b"x,y\n1,2\n3,4\n",
                b"p 1 2 3\np 4 5 6\n",
            ]
        )
    )
    damaged = bytearray(whole[: data.draw(st.integers(1, len(whole)))])
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        points = parse_points(bytes(damaged), "cloud")
    except FileFormatError:
        return
    assert points.ndim == 2
    assert np.isfinite(points).all()


@given(st.text(max_size=60))
@settings(max_examples=100, deadline=None)
def test_arbitrary_text(text: str) -> None:
    try:
        parse_points(text.encode("utf-8", "surrogatepass"), "cloud", ".txt")
    except FileFormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 - the error is one of two good outcomes


def test_read_points_goes_by_the_ending(tmp_path: object) -> None:
    from pathlib import Path

    folder = Path(str(tmp_path))
    (folder / "a.csv").write_text("x,y\n1,2\n")
    np.testing.assert_array_equal(read_points(folder / "a.csv"), [[1.0, 2.0]])
    (folder / "a.doc").write_text("1 2\n")
    with pytest.raises(FileFormatError, match=r"'\.doc'.*\.ply \.xyz"):
        read_points(folder / "a.doc")
    with pytest.raises(FileNotFoundError):
        read_points(folder / "none.xyz")
