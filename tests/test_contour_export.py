"""Contours in SVG, DXF and GeoJSON, read back by programs that did not write them; atomic writing."""

from __future__ import annotations

import json
import os
import re
import stat
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from tspline.errors import InvalidArgumentError
from tspline.export import ContourFrame, complete_or_absent, write_contours
from tspline.export.geojson import nested_polygons, signed_area
from tspline.export.svg import cubic_handles

ezdxf = pytest.importorskip("ezdxf")


def circle(row: float, col: float, radius: float, count: int = 60, turn: int = 1) -> np.ndarray:
    angle = turn * np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.column_stack([row + radius * np.sin(angle), col + radius * np.cos(angle)])


RING = [circle(20, 30, 15), circle(20, 30, 6, turn=-1), circle(20, 30, 2), circle(5, 70, 3, turn=-1)]
SHAPE = (40, 80)


def svg_paths(text: str) -> list[tuple[list[str], np.ndarray]]:
    """(commands, end points of the segments) of each subpath."""
    root = ET.fromstring(text)
    data = root.find("{http://www.w3.org/2000/svg}path").get("d")
    paths = []
    for part in re.findall(r"M[^M]*Z", data):
        commands = re.findall(r"[MLCZ]", part)
        ends = [numbers.split()[-1] for numbers in re.split(r"[MLCZ]", part) if numbers.strip()]
        paths.append((commands, np.array([[float(x) for x in end.split(",")] for end in ends])))
    return paths


def test_svg_of_an_image(tmp_path: Path) -> None:
    path = tmp_path / "c.svg"
    write_contours(path, RING, ContourFrame.of_image(SHAPE))
    text = path.read_text()
    root = ET.fromstring(text)
    assert root.get("viewBox") == "0 0 80 40"
    assert root.find("{http://www.w3.org/2000/svg}path").get("fill-rule") == "evenodd"
    paths = svg_paths(text)
    assert len(paths) == len(RING)
    for (commands, points), contour in zip(paths, RING, strict=True):
        assert commands[0] == "M"
        assert commands[-1] == "Z"
        assert set(commands[1:-1]) == {"C"}
        # the origin of SVG is the image's corner, half a pixel from the first pixel's centre
        np.testing.assert_allclose(points[:-1], contour[:, ::-1] + 0.5, atol=1e-6)
        np.testing.assert_allclose(points[-1], points[0])


def test_svg_cubics_follow_a_circle() -> None:
    """At 60 points the handles' error is of fourth order: 100 times below the chords' 1.4e-3."""
    curve = circle(0, 0, 1.0)
    first, second = cubic_handles(curve, np.zeros(60, dtype=bool))
    middle = (curve + 3.0 * first + 3.0 * second + np.roll(curve, -1, axis=0)) / 8.0
    assert np.abs(np.hypot(*middle.T) - 1.0).max() < 1e-5


def test_svg_keeps_the_border_straight(tmp_path: Path) -> None:
    contour = np.array([[-0.5, 2.0], [-0.5, 6.0], [3.0, 7.0], [5.0, 4.0], [3.0, 1.0]])
    flags = np.array([True, True, False, False, False])
    path = tmp_path / "c.svg"
    write_contours(path, [contour], ContourFrame.of_image((10, 10)), border=[flags])
    ((commands, points),) = svg_paths(path.read_text())
    assert "".join(commands) == "MLCCCCZ"
    assert points[0, 1] == 0.0  # the image's edge


def test_svg_of_the_plane_turns_y_downward(tmp_path: Path) -> None:
    path = tmp_path / "c.svg"
    square = np.array([[1.0, 2.0], [3.0, 2.0], [3.0, 4.0], [1.0, 4.0]])
    write_contours(path, [square], ContourFrame.of_box([[0.0, 1.0], [5.0, 6.0]]))
    ((_, points),) = svg_paths(path.read_text())
    np.testing.assert_allclose(points[:4], np.column_stack([square[:, 0], 6.0 - square[:, 1]]))


def test_dxf_points_y_up(tmp_path: Path) -> None:
    path = tmp_path / "c.dxf"
    write_contours(path, RING, ContourFrame.of_image(SHAPE))
    lines = list(ezdxf.readfile(path).modelspace().query("LWPOLYLINE"))
    assert len(lines) == len(RING)
    for line, contour in zip(lines, RING, strict=True):
        assert line.closed
        points = np.array([(x, y) for x, y, *_ in line.get_points()])
        np.testing.assert_allclose(points, np.column_stack([contour[:, 1], 39.0 - contour[:, 0]]), atol=1e-9)
    write_contours(path, [RING[0]], ContourFrame.of_box([[0, 0], [1, 1]]))
    (line,) = ezdxf.readfile(path).modelspace().query("LWPOLYLINE")
    np.testing.assert_allclose([(x, y) for x, y, *_ in line.get_points()], RING[0])


def test_dxf_without_ezdxf_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(ImportError, match=r"tspline\[dxf\]"):
        write_contours(tmp_path / "c.dxf", RING, ContourFrame.of_image(SHAPE))


def test_geojson_has_holes_and_the_right_hand_rule(tmp_path: Path) -> None:
    path = tmp_path / "c.geojson"
    write_contours(path, RING, ContourFrame.of_image(SHAPE))
    collection = json.loads(path.read_text())
    assert collection["type"] == "FeatureCollection"
    polygons = [feature["geometry"]["coordinates"] for feature in collection["features"]]
    assert [len(rings) for rings in polygons] == [2, 1, 1]  # the ring, the disc in its hole, the other disc
    for rings in polygons:
        for place, ring in enumerate(rings):
            points = np.array(ring)
            np.testing.assert_array_equal(points[0], points[-1])
            assert (signed_area(points[:-1]) > 0) == (place == 0)
    found = np.array(polygons[0][0][:-1])
    expected = RING[0][:, ::-1]
    assert {tuple(p) for p in found} == {tuple(p) for p in expected}


def test_nesting_is_by_the_smallest_curve_around() -> None:
    nest = [circle(0, 0, radius) for radius in (5, 1, 4, 2, 3)]
    assert sorted(map(tuple, nested_polygons(nest))) == [(0, 2), (1,), (4, 3)]


def test_area_far_from_the_origin() -> None:
    """A square metre in map coordinates: the shoelace formula alone would lose it to rounding."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) + 1e9
    assert signed_area(square) == 1.0


@pytest.mark.parametrize("ending", [".svg", ".dxf", ".geojson"])
def test_no_contours_give_a_valid_file(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"c{ending}"
    write_contours(path, [], ContourFrame.of_image(SHAPE))
    text = path.read_text()
    if ending == ".svg":
        ET.fromstring(text)
    elif ending == ".geojson":
        assert json.loads(text)["features"] == []
    else:
        assert len(ezdxf.readfile(path).modelspace()) == 0


@pytest.mark.parametrize("contour", [np.zeros((2, 2)), np.zeros((5, 3)), np.full((5, 2), np.nan)])
def test_bad_contours_are_refused(tmp_path: Path, contour: np.ndarray) -> None:
    with pytest.raises(InvalidArgumentError, match="contours"):
        write_contours(tmp_path / "c.svg", [contour], ContourFrame.of_image(SHAPE))


def test_unknown_ending(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"\.svg, \.dxf, \.geojson"):
        write_contours(tmp_path / "c.pdf", RING, ContourFrame.of_image(SHAPE))


def test_a_file_is_complete_or_absent(tmp_path: Path) -> None:
    path = tmp_path / "a.tsp.npz"
    for error in (ValueError, KeyboardInterrupt, SystemExit):
        with pytest.raises(error), complete_or_absent(path) as temporary:  # noqa: PT012 - the block is tested
            assert temporary.parent == tmp_path
            assert temporary.name.endswith(".tsp.npz")
            temporary.write_bytes(b"half")
            assert not path.exists()
            raise error
        assert list(tmp_path.iterdir()) == []
    with complete_or_absent(path) as temporary:
        temporary.write_bytes(b"whole")
    assert path.read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [path]


def test_existing_files_need_force(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o640)
    with pytest.raises(FileExistsError) as caught, complete_or_absent(path):
        pytest.fail("the block must not run")
    assert caught.value.filename == str(path)
    with complete_or_absent(path, force=True) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(FileExistsError), complete_or_absent(path) as temporary:  # noqa: PT012 - as above
        temporary.write_text("mine")
        path.write_text("theirs")
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


def test_links_are_followed_and_folders_refused(tmp_path: Path) -> None:
    real = tmp_path / "real.txt"
    real.write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to(real)
    with complete_or_absent(link, force=True) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    with pytest.raises(IsADirectoryError), complete_or_absent(tmp_path, force=True):
        pytest.fail("the block must not run")
    with pytest.raises(FileNotFoundError) as caught, complete_or_absent(tmp_path / "none" / "a.txt"):
        pytest.fail("the block must not run")
    assert caught.value.filename == str(tmp_path / "none" / "a.txt")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_full_disk_is_an_error_with_the_final_name() -> None:
    with (
        pytest.raises(OSError, match="No space left") as caught,
        complete_or_absent("/dev/full") as temporary,
    ):
        temporary.write_bytes(b"x" * 10_000)
    assert caught.value.filename == "/dev/full"


def test_objects_that_touch_are_features_of_their_own(tmp_path: Path) -> None:
    """Their common side lies on both; each keeps its hole and its number."""
    left = np.array([[0.0, 0.0], [0.0, 4.0], [8.0, 4.0], [8.0, 0.0]])
    hole = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]])
    right = np.array([[2.0, 4.0], [2.0, 7.0], [6.0, 7.0], [6.0, 4.0]])
    path = tmp_path / "c.geojson"
    write_contours(path, [left, hole, right], ContourFrame.of_image((12, 12)), labels=[3, 3, 7])
    features = json.loads(path.read_text())["features"]
    assert [feature["properties"]["label"] for feature in features] == [3, 7]
    assert [len(feature["geometry"]["coordinates"]) for feature in features] == [2, 1]
