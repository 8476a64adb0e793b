"""Normals, scanners' formats and large files: every reader against what was written, precision included."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from recon.point_file import parse_points, parse_scan, read_scan
from recon.scan import Scan
from tspline.errors import FileFormatError

NUM = 50
UTM = np.array([512_345.0, 5_403_210.0, 812.0])
"""A place in metres as surveyors give it: with millimetres ten digits count, more than single precision has."""


@pytest.fixture
def points(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(NUM, 3))


@pytest.fixture
def normals(rng: np.random.Generator) -> np.ndarray:
    arrows = rng.normal(size=(NUM, 3))
    return arrows / np.linalg.norm(arrows, axis=1, keepdims=True)


def ply(kind: str, columns: dict[str, np.ndarray], types: dict[str, str], after: bytes = b"") -> bytes:
    """A PLY file with the columns as vertex properties."""
    names = {"f4": "float", "f8": "double", "u1": "uchar"}
    count = len(next(iter(columns.values())))
    head = [f"ply\nformat {kind} 1.0\ncomment made by a test\nelement vertex {count}"]
    head += [f"property {names[types[name]]} {name}" for name in columns]
    head += ["element face 0", "property list uchar int vertex_indices", "end_header\n"]
    if kind == "ascii":
        rows = zip(*columns.values(), strict=True)
        return "\n".join(head).encode() + "".join(" ".join(repr(float(x)) for x in r) + "\n" for r in rows).encode()
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    table = np.zeros(count, dtype=[(name, order + types[name]) for name in columns])
    for name, column in columns.items():
        table[name] = column
    return "\n".join(head).encode() + table.tobytes() + after


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_with_normals_anywhere_among_the_properties(kind: str, points: np.ndarray, normals: np.ndarray) -> None:
    names = ("nx", "x", "red", "y", "ny", "z", "nz")
    types = {name: "u1" if name == "red" else "f8" for name in names}
    columns = dict(zip(("x", "y", "z"), points.T, strict=True)) | dict(zip(("nx", "ny", "nz"), normals.T, strict=True))
    columns |= {"red": np.arange(NUM, dtype=float)}
    scan = read_back(ply(kind, {name: columns[name] for name in names}, types), ".ply")
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.normals, normals)
    assert scan.notes == ()


def read_back(data: bytes, ending: str | None) -> Scan:
    scan = parse_scan(data, "scan", ending)
    assert scan.points.dtype == np.float64
    assert scan.points.flags.c_contiguous
    assert np.array_equal(parse_points(data, "scan", ending), scan.points)
    return scan


@pytest.mark.parametrize("ending", [".xyz", ".txt", ".csv", ".pts"])
def test_six_columns_are_points_and_normals(ending: str, points: np.ndarray, normals: np.ndarray) -> None:
    mark = "," if ending == ".csv" else " "
    table = np.hstack([points, normals])
    text = "\n".join(mark.join(repr(float(x)) for x in row) for row in table).encode()
    scan = read_back(text, ending)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.normals, normals)


def test_six_columns_with_colours_are_no_normals(points: np.ndarray, rng: np.random.Generator) -> None:
    table = np.hstack([points, rng.integers(0, 256, (NUM, 3))])
    scan = parse_scan("\n".join(" ".join(repr(float(x)) for x in row) for row in table).encode(), "scan")
    np.testing.assert_array_equal(scan.points, points)
    assert scan.normals is None
    assert "columns 4 to 6 are not used" in scan.notes[0]


def test_named_columns_give_normals(points: np.ndarray, normals: np.ndarray) -> None:
    table = np.hstack([normals, np.arange(NUM)[:, None], points])
    text = "nx,ny,nz,id,x,y,z\n" + "\n".join(",".join(repr(float(x)) for x in row) for row in table)
    scan = read_back(text.encode(), ".csv")
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.normals, normals)


def test_normals_that_are_zero_are_told_and_left_out() -> None:
    scan = parse_scan(b"x y z nx ny nz\n1 2 3 0 0 1\n4 5 6 0 0 0\n", "scan")
    assert scan.normals is None
    assert scan.notes == ("the normals are not used: 1 of them are zero or not finite",)


@pytest.mark.parametrize("extra", [0, 1, 3, 4])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_scanners_put_a_count_first_and_intensity_and_colour_last(extra: int, newline: str, points: np.ndarray) -> None:
    rest = " ".join(["-1023", "10", "20", "30"][:extra] if extra != 3 else ["10", "20", "30"])
    lines = [str(NUM), *(" ".join(repr(float(x)) for x in row) + (" " + rest if rest else "") for row in points)]
    np.testing.assert_array_equal(read_back(newline.join(lines).encode(), ".pts").points, points)


@pytest.mark.parametrize("also", ["", "vn", "faces", "swapped", "more", "uneven"])
def test_obj_has_normals_where_each_vertex_has_one(also: str, points: np.ndarray, normals: np.ndarray) -> None:
    lines = ["# comment", "mtllib a.mtl", *("v " + " ".join(repr(float(x)) for x in row) for row in points)]
    if also:
        lines += ["vn " + " ".join(repr(float(x)) for x in row) for row in normals]
    lines += {
        "faces": ["f 1//1 2/7/2 13/1/13", "f 3//3 4//4 5//5"],
        "swapped": ["f 1//1 2//2 13//1"],
        "more": ["vn 0 0 1"],
        "uneven": ["vt 0 0", "f 1/1 2/1 3/1"],
    }.get(also, [])
    scan = read_back("\n".join(lines).encode(), ".obj")
    np.testing.assert_array_equal(scan.points, points)
    if also in ("vn", "faces", "uneven"):
        np.testing.assert_array_equal(scan.normals, normals)
    else:
        assert scan.normals is None


def test_obj_agrees_with_trimesh() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=1)
    text = sphere.export(file_type="obj", include_normals=True, digits=17)
    scan = parse_scan(text.encode(), "scan", ".obj")
    np.testing.assert_array_equal(scan.points, sphere.vertices)
    np.testing.assert_allclose(scan.normals, sphere.vertex_normals, atol=1e-15)


def test_numpy_files_with_normals(points: np.ndarray, normals: np.ndarray) -> None:
    stream = io.BytesIO()
    np.savez(stream, points=points, normals=normals, colours=np.zeros(3))
    scan = read_back(stream.getvalue(), None)
    np.testing.assert_array_equal(scan.normals, normals)
    stream = io.BytesIO()
    np.save(stream, np.hstack([points, normals]))
    np.testing.assert_array_equal(read_back(stream.getvalue(), None).normals, normals)
    stream = io.BytesIO()
    np.savez(stream, points=points, normals=normals[1:])
    with pytest.raises(FileFormatError, match="a normal for each point"):
        parse_scan(stream.getvalue(), "scan")


@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 30), st.sampled_from([2, 3])), elements=st.floats(-1e12, 1e12)),
    st.sampled_from(["", "x,y,z\n", "# a\n\n", "{n}\n", "p", "v"]),
    st.booleans(),
)
def test_text_keeps_every_bit(points: np.ndarray, head: str, slow: bool) -> None:
    """However the file begins, and whether it is read at once or (with a comment inside) line by line."""
    letter = head + " " if head in ("p", "v") else ""
    lines = [letter + " ".join(repr(float(x)) for x in row) for row in points]
    if slow:
        lines.insert(1, "# inside")
    columns = ",".join("xyz"[: points.shape[1]]) + "\n"
    first = "" if letter else columns if head.startswith("x") else head.format(n=len(points))
    np.testing.assert_array_equal(parse_points((first + "\n".join(lines)).encode(), "scan", ".txt"), points)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"x,y,z\n1,2,3\n4,5\n", "scan:3: 2 numbers"),
        (b"# c\n1 2 3\n4 5 6\n7 8 9 1\n", "scan:4: 4 numbers"),
        (b"3\n1 2 3 9\n4 5 6 9\n", "announces 3 points, found 2"),
        (b"p 1 2 3\np 4 5\n", "scan:2: 2 numbers"),
        (b"p 1 2 3\n4 5 6\n", "scan:2: the line '4 5 6'"),
        (b"x;y\n1,5;2\n2,5;3;4\n", "scan:3: 3 numbers"),
    ],
)
def test_the_wrong_line_is_told_wherever_it_stands(text: bytes, told: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        parse_scan(text, "scan", ".txt")
    assert told in str(caught.value)


SCANS = {
    "hoppe_cactus.pts": 3318, "hoppe_curve1.pts": 126, "hoppe_distcap.pts": 12745, "pgr_Utah_teapot_5000.xyz": 5000,
    "vipss_noise_kitten_kitten_h001.001.xyz": 500, "vipss_planck_multisample_n1000.xyz": 1000,
    "vipss_torus_multisample_n50.xyz": 50, "vipss_torus_parallelcut.xyz": 499, "vipss_wireframes_spring.xyz": 999,
}  # fmt: skip
"""Lines with a point, counted by `grep -c`."""


@pytest.mark.parametrize("name", SCANS)
def test_scans_of_others(name: str, data_folder: Path) -> None:
    path = data_folder / "scans" / name
    if not path.exists():
        pytest.skip("this data folder has no scans")
    scan = read_scan(path)
    assert scan.points.shape == (SCANS[name], 3)
    assert scan.normals is None
    last = path.read_text().split()[-3:]
    np.testing.assert_array_equal(scan.points[-1], [float(word) for word in last])


def las(points: np.ndarray, *, compressed: bool) -> bytes:
    laspy = pytest.importorskip("laspy")
    if compressed:
        pytest.importorskip("lazrs")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = UTM, np.full(3, 0.001)
    file = laspy.LasData(header)
    file.x, file.y, file.z = points.T
    stream = io.BytesIO()
    file.write(stream, do_compress=compressed)
    return stream.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
def test_las_keeps_millimetres_far_from_the_origin(compressed: bool, points: np.ndarray) -> None:
    placed = np.round(points, 3) + UTM
    scan = read_back(las(placed, compressed=compressed), ".laz" if compressed else ".las")
    # the file holds whole millimetres: what is left is the rounding of numbers of this size
    np.testing.assert_allclose(scan.points, placed, rtol=0, atol=4e-9)
    np.testing.assert_array_equal(read_back(las(placed, compressed=compressed), None).points, scan.points)


def e57(folder: Path, clouds: list[np.ndarray], shifts: list[np.ndarray]) -> Path:
    pye57 = pytest.importorskip("pye57")
    path = folder / "scan.e57"
    with pye57.E57(str(path), mode="w") as file:
        for cloud, shift in zip(clouds, shifts, strict=True):
            # its writer keeps single precision
            data = {f"cartesian{axis}": column.copy() for axis, column in zip("XYZ", cloud.T, strict=True)}
            file.write_scan_raw(data, rotation=np.array([1.0, 0.0, 0.0, 0.0]), translation=shift)
    return path


def test_e57_joins_its_scans_where_they_stand(tmp_path: Path, points: np.ndarray) -> None:
    single = points.astype(np.float32).astype(np.float64)
    path = e57(tmp_path, [single, single[:7]], [UTM, np.zeros(3)])
    scan = read_scan(path)
    np.testing.assert_allclose(scan.points, np.vstack([single + UTM, single[:7]]), rtol=0, atol=2e-9)
    np.testing.assert_array_equal(parse_points(path.read_bytes(), "<stdin>"), scan.points)


@pytest.mark.parametrize(("ending", "module"), [(".las", "laspy"), (".laz", "laspy"), (".e57", "pye57")])
def test_without_its_package_the_extra_is_named(
    ending: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    path = tmp_path / f"a{ending}"
    path.write_bytes((b"LASF" if module == "laspy" else b"ASTM-E57") + bytes(300))
    with pytest.raises(FileFormatError) as caught:
        read_scan(path)
    assert f"the package {module} is missing; accepted is pip install 'tspline[scan]'" in str(caught.value)
    # what is no such file needs no package to say so
    path.write_bytes(b"1 2 3\n")
    with pytest.raises(FileFormatError, match=r"no (LAS|E57) file"):
        read_scan(path)


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (100, 0xFFFFFFFF, "more records declared"),
        (107, 60, "60 points declared, data for 50"),
        (107, 0xFFFFFFFF, "4294967295 points declared"),
        (96, 0, "damaged LAS file|data for"),
    ],
)
def test_las_headers_that_lie(place: int, value: int, told: str, points: np.ndarray) -> None:
    data = bytearray(las(points + UTM, compressed=False))
    data[place : place + 4] = value.to_bytes(4, "little")
    with pytest.raises(FileFormatError, match=told):
        parse_scan(bytes(data), "scan", ".las")


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_damaged_scanner_files(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    sphere = np.random.default_rng(0).normal(size=(NUM, 3))
    ending = data.draw(st.sampled_from([".las", ".laz", ".e57"]))
    if ending == ".e57":
        whole = e57(tmp_path_factory.mktemp("e57"), [sphere], [UTM]).read_bytes()
    else:
        whole = las(sphere + UTM, compressed=ending == ".laz")
    damaged = bytearray(whole[: data.draw(st.integers(1, len(whole)))])
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        scan = parse_scan(bytes(damaged), "scan", ending)
    except FileFormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 - the error is one of two good outcomes
        return
    assert np.isfinite(scan.points).all()
