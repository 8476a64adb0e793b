"""The command from end to end with the real solvers; what it writes is read by programs of others."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image
from scipy import ndimage

import tspline
from cli.main import main

NUM_POINTS = 200
CENTERS = np.array([[0.0, 0.0], [5.0, 1.0]])
RADII = np.array([2.0, 1.0])
DISC = (40.0, 52.0, 20.0)
"""Row, column and radius in the test image."""
KNOT_LENGTH = 28.826
"""Of the middle line of the demonstration's tube, by quadrature."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with an image of one disc and points of two circles."""
    monkeypatch.chdir(tmp_path)
    row, col = np.mgrid[0:88, 0:96]
    cover = np.clip(DISC[2] - np.hypot(row - DISC[0], col - DISC[1]) + 0.5, 0.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 4.0, cover.shape)
    grey = np.round(60.0 + 120.0 * ndimage.gaussian_filter(cover, 0.7) + noise)
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save("disc.png")
    angle = 2.0 * np.pi * (np.arange(NUM_POINTS // 2) + 0.5) / (NUM_POINTS // 2)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.vstack([center + radius * ring for center, radius in zip(CENTERS, RADII, strict=True)])
    np.savetxt("rings.csv", np.random.default_rng(2).permutation(points), delimiter=",", header="x,y", comments="")
    return tmp_path


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    """The one JSON object on standard output."""
    (line,) = capsys.readouterr().out.splitlines()
    record: dict[str, object] = json.loads(line)
    return record


def test_segment(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outputs = [
        "--mask",
        "m.png",
        "--labels",
        "l.tif",
        "--contour",
        "c.geojson",
        "--figure",
        "f.png",
        "--model",
        "s.npz",
    ]
    assert main(["segment", "disc.png", "--json", *outputs, "--animation", "a.gif"]) == 0
    record = said(capsys)
    assert (record["status"], record["components"]) == (0, 1)
    row, col = np.mgrid[0:88, 0:96]
    truth = np.hypot(row - DISC[0], col - DISC[1]) < DISC[2]
    mask = np.asarray(Image.open("m.png")) == 255
    # a tenth of a pixel along the outline, 126 pixels long, is one part in a hundred of the area
    assert np.count_nonzero(mask ^ truth) < 0.01 * np.count_nonzero(truth)
    np.testing.assert_array_equal(tifffile.imread("l.tif"), mask)
    (feature,) = json.loads(Path("c.geojson").read_text(encoding="utf-8"))["features"]
    (curve,) = feature["geometry"]["coordinates"]
    radius = np.hypot(*(np.array(curve) - [DISC[1], DISC[0]]).T)
    assert np.sqrt(np.mean((radius - DISC[2]) ** 2)) < 0.2
    assert abs(radius.mean() - DISC[2]) < 0.05
    with Image.open("a.gif") as animation:
        assert animation.n_frames > 1
    with Image.open("f.png") as figure:
        assert min(figure.size) > 300


def test_fit_and_info(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "rings.csv", "--json", "--model", "r.tsp.npz", "--contour", "r.geojson"]) == 0
    record = said(capsys)
    assert (record["status"], record["components"], record["num_points"]) == (0, 2, NUM_POINTS)
    assert isinstance(record["max_residual"], float)
    # exact data: the spline's own error on cells of half a radius and less
    assert record["max_residual"] < 0.01
    features = json.loads(Path("r.geojson").read_text(encoding="utf-8"))["features"]
    found = [np.array(feature["geometry"]["coordinates"][0]) for feature in features]
    curves = sorted(found, key=lambda curve: float(curve[:, 0].mean()))
    for curve, center, radius in zip(curves, CENTERS, RADII, strict=True):
        # between the points, a chord of the circle is off by radius * (1 - cos(pi / 100)) = 0.0005 radius
        assert np.abs(np.hypot(*(curve - center).T) - radius).max() < 0.01
    assert main(["info", "r.tsp.npz", "--json"]) == 0
    told = said(capsys)
    assert (told["kind"], told["components"], told["num_coefficients"]) == ("model", 2, record["num_coefficients"])


def test_fit_from_a_circle(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "rings.csv", "--init", "circle", "--json", "--contour", "r.svg"]) == 0
    assert said(capsys)["components"] == 2
    (path,) = ElementTree.parse("r.svg").getroot().iter("{http://www.w3.org/2000/svg}path")
    assert path.get("d", "").count("M") == 2


def test_nothing_found_is_3_and_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ramp = np.tile(np.linspace(40, 200, 64), (64, 1)).astype(np.uint8)
    Image.fromarray(ramp).save("ramp.png")
    assert main(["segment", "ramp.png", "--mask", "m.png"]) == 3
    assert "ramp.png: 0 objects" in (line := capsys.readouterr().out.splitlines()[0])
    assert "nothing found" in line
    assert not np.asarray(Image.open("m.png")).any()


def test_warnings_go_to_standard_error(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = np.loadtxt("rings.csv", delimiter=",", skiprows=1)
    np.savetxt("plane.xyz", np.column_stack([points, np.zeros(len(points))]))
    assert main(["fit", "plane.xyz", "--model", "p.npz"]) == 0
    written = capsys.readouterr()
    assert written.err == "tspline fit: warning: plane.xyz: all points have the same z, which is left out\n"
    assert main(["fit", "plane.xyz", "--model", "p.npz", "--force", "--quiet"]) == 0
    written = capsys.readouterr()
    assert (written.out, written.err) == ("", "")


def test_demo(folder: Path) -> None:
    assert main(["demo", "--out", "shown", "--quiet"]) == 0
    shown = folder / "shown"
    labels = tifffile.imread(shown / "coins_labels.tif")
    # 24 coins; parts at the image's border may come on top of them
    assert 24 <= labels.max() <= 26
    with np.load(shown / "coins.tsp.npz", allow_pickle=False) as model:
        # a size by contour and not by area
        assert model["coefficients"].size < 0.06 * labels.size
    (path,) = ElementTree.parse(shown / "ampersand.svg").getroot().iter("{http://www.w3.org/2000/svg}path")
    assert path.get("d", "").count("M") == 2
    mesh = trimesh.load(shown / "knot.ply")
    assert mesh.is_watertight
    # one tube, closed to a ring
    assert (mesh.body_count, mesh.euler_number) == (1, 0)
    # a disc of radius 0.5 all along the knot; measured 0.1 % less
    assert tspline.load(shown / "knot.tsp.npz").volume() == pytest.approx(np.pi * 0.5**2 * KNOT_LENGTH, rel=0.01)
    for name in ("coins_figure.png", "ampersand_figure.png", "knot_figure.png"):
        with Image.open(shown / name) as figure:
            assert figure.width > 1000
            figure.load()


def test_segment_into_classes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grey = np.asarray(Image.open("disc.png")).copy()
    grey[55:75, 5:25] = 240
    Image.fromarray(grey).save("three.png")
    words = ["--phases", "3", "--labels", "c.tif", "--mask", "m.png", "--contour", "c.geojson"]
    assert main(["segment", "three.png", "--json", *words]) == 0
    record = said(capsys)
    features = json.loads(Path("c.geojson").read_text(encoding="utf-8"))["features"]
    rings = [(f["properties"]["label"], len(f["geometry"]["coordinates"])) for f in features]
    # The background has two holes.
    assert rings == [(0, 3), (1, 1), (2, 1)]
    classes = tifffile.imread("c.tif")
    np.testing.assert_array_equal(np.unique(classes), [0, 1, 2])
    assert record["class_areas"] == np.bincount(classes.ravel()).tolist()
    assert (record["components"], record["background"]) == (2, 0)
    assert np.count_nonzero(classes == 2) == pytest.approx(400, abs=12)
    # Single pixels on the outline may fall to either side.
    assert np.count_nonzero((np.asarray(Image.open("m.png")) == 255) != (classes > 0)) <= 3


def test_segment_keeps_touching_objects_apart(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row, col = np.mgrid[0:80, 0:110]
    cover = np.minimum(np.hypot(row - 40, col - 34), np.hypot(row - 40, col - 72)) < 20.5
    Image.fromarray(np.where(cover, 200, 60).astype(np.uint8)).save("pair.png")
    words = ["segment", "pair.png", "--json", "--separate", "--labels", "l.png", "--contour", "p.geojson"]
    assert main(words) == 0
    assert said(capsys)["components"] == 2
    areas = np.bincount(np.asarray(Image.open("l.png")).ravel())[1:]
    np.testing.assert_allclose(areas, np.count_nonzero(cover) / 2, rtol=0.02)
    assert len(json.loads(Path("p.geojson").read_text(encoding="utf-8"))["features"]) == 2


def test_wrong_number_of_classes_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["segment", "disc.png", "--phases", "1", "--mask", "m.png"]) == 2
    assert "phases" in capsys.readouterr().err
