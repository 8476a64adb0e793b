"""Tables, reports, classes and folders of ``tspline segment`` where images have a spacing, and of volumes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from dicom_maker import write_series
from PIL import Image
from test_cli_volume import GREY, RADIUS, SHAPE, found_ball

import segment
from cli.inputs import expand
from cli.main import main
from segment.picture import PICTURE_ENDINGS, read_picture

DISC = 14.0
"""Radius in pixels, around (30, 36)."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a disc in three brightnesses of ground, pixels of a quarter of a micrometre."""
    monkeypatch.chdir(tmp_path)
    row, col = np.indices((64, 72))
    disc = 40 + 160 * np.clip(DISC + 0.5 - np.hypot(row - 30, col - 36), 0, 1)
    tifffile.imwrite("d.tif", np.rint(disc).astype(np.uint8), imagej=True, resolution=(4, 4), metadata={"unit": "um"})
    Image.fromarray(np.rint(disc).astype(np.uint8)).save("plain.png")
    return tmp_path


@pytest.fixture
def ball(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, with volumes that a stand-in for the solver finds a ball in."""
    monkeypatch.setattr(segment, "segment_image", found_ball)
    np.savez("v.npz", image=GREY, spacing=[2.0, 1.0, 0.75])
    return folder


def read(name: str) -> list[dict[str, str]]:
    with Path(name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_tables_and_reports_of_images_with_a_spacing(folder: Path) -> None:
    words = ["--table", "t.csv", "--objects", "o.csv", "--report", "r.html", "--figure", "f.png"]
    assert main(["segment", "d.tif", *words]) == 0
    (row,), (one,) = read("t.csv"), read("o.csv")
    assert float(row["area_total_px"]) == pytest.approx(np.pi * DISC**2, rel=5e-3)
    assert float(row["area_total"]) == pytest.approx(float(row["area_total_px"]) / 16, rel=1e-8)
    assert (row["unit"], one["unit"]) == ("um", "um")
    assert float(one["perimeter"]) == pytest.approx(2 * np.pi * DISC / 4, rel=5e-3)
    # places stay in pixels
    assert float(one["centroid_row"]) == pytest.approx(30.0, abs=0.05)
    assert float(one["box_col1"]) == pytest.approx(36.0 + DISC, abs=0.2)
    page = Path("r.html").read_text(encoding="utf-8")
    assert "<small>um²</small>" in page
    # the T-mesh is drawn over the pixels
    assert "h7200" in page.partition('class="mesh"')[2].partition("</")[0]


@pytest.mark.parametrize("sides", [(1.0, 1.0), (3.0, 1.5)])
def test_a_spacing_is_heeded_although_the_model_is_in_pixels(folder: Path, sides: tuple[float, float]) -> None:
    words = ["--spacing", ",".join(map(str, sides)), "--table", "t.csv", "--report", "r.html"]
    assert main(["segment", "plain.png", *words]) == 0
    (row,) = read("t.csv")
    assert float(row["area_total"]) == pytest.approx(np.pi * DISC**2 * np.prod(sides), rel=5e-3)
    page = Path("r.html").read_text(encoding="utf-8")
    assert ("scale(1 2)" in page) == (sides[0] > sides[1])


def test_channels_that_are_no_colours(folder: Path) -> None:
    """A report shows the first of them."""
    with Image.open("plain.png") as image:
        grey = np.asarray(image)
    np.save("five.npy", np.stack([grey] * 5))
    assert main(["segment", "five.npy", "--channel-axis", "0", "--report", "r.html", "--table", "t.csv"]) == 0
    page = Path("r.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 1
    assert "channel-axis 0" in page
    assert read("t.csv")[0]["objects"] == "1"


def test_classes_in_the_geometry_of_the_image(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tifffile.imread("d.tif")
    image[:, :10] = 120
    tifffile.imwrite("three.tif", image, imagej=True, resolution=(4, 4), metadata={"unit": "um"})
    words = ["--phases", "3", "--labels", "c.nrrd", "--mask", "m.tif", "--table", "t.csv", "--json"]
    assert main(["segment", "three.tif", *words]) == 0
    record = json.loads(capsys.readouterr().out)
    classes = read_picture("c.nrrd")
    np.testing.assert_allclose(classes.spacing, [0.25, 0.25])
    assert [int(np.count_nonzero(classes.pixels == k)) for k in range(3)] == record["class_areas"]
    assert (record["shape"], record["unit"], record["background"]) == ([64, 72], "um", 0)
    assert read("t.csv")[0]["unit"] == "um"


def test_touching_objects_with_a_spacing(folder: Path) -> None:
    row, col = np.indices((64, 96))
    pair = np.minimum(np.hypot(row - 32, col - 32), np.hypot(row - 32, col - 62)) < 16.5
    Image.fromarray(np.where(pair, 200, 40).astype(np.uint8)).save("pair.png")
    words = ["--separate", "--spacing", "0.5", "--labels", "l.npz", "--contour", "c.geojson", "--objects", "o.csv"]
    assert main(["segment", "pair.png", *words]) == 0
    with np.load("l.npz") as arrays:
        assert arrays["labels"].max() == 2
        np.testing.assert_allclose(arrays["spacing"], 0.5)
    features = json.loads(Path("c.geojson").read_text())["features"]
    assert len(features) == 2
    ends = np.concatenate([np.array(one["geometry"]["coordinates"][0]) for one in features])
    np.testing.assert_allclose([ends[:, 0].min(), ends[:, 0].max()], [7.75, 39.25], atol=0.5)
    assert [row["label"] for row in read("o.csv")] == ["1", "2"]


def test_tables_and_reports_of_volumes(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--table", "t.csv", "--objects", "o.csv", "--report", "r.html", "--mesh", "m.ply", "--figure", "f.png"]
    assert main(["segment", "v.npz", *words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["shape"], record["dim"]) == (list(SHAPE), 3)
    (row,), (one,) = read("t.csv"), read("o.csv")
    volume = 4 / 3 * np.pi * RADIUS**3
    assert float(row["volume_total_px"]) == pytest.approx(volume, rel=0.02)
    assert float(row["volume_total"]) == pytest.approx(volume * 2.0 * 0.75, rel=0.02)
    assert row["area_total_px"] == row["edge_share"] == ""
    assert one["measured_on"] == "surface"
    assert float(one["centroid_plane"]) == pytest.approx(8.0, abs=0.01)
    page = Path("r.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 3
    assert "16 × 17 × 18 voxels" in page
    assert "m.ply" not in page


def test_folders_of_images_volumes_and_series(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("study").mkdir()
    for name in ("d.tif", "v.npz"):
        Path(name).rename(Path("study") / name)
    write_series(Path("study/scan"), GREY.astype(np.int16), np.eye(3)[:, ::-1] * [3.0, 2.0, 1.5], np.zeros(3))
    Path("study/earlier.tsp.npz").write_bytes(b"a model is no input")
    words = ["--recursive", "--report", "r.html", "--table", "t.csv"]
    assert [item.path for item in expand(["study"], PICTURE_ENDINGS)] == ["study/d.tif", "study/v.npz"]
    items = expand(["study"], PICTURE_ENDINGS, recursive=True)
    assert [item.path for item in items][2:] == ["study/scan"]
    # commands that read no DICOM look for their own files in such a folder
    assert main(["fit", "study/scan"]) == 2
    assert "study/scan: found no file directly in it" in capsys.readouterr().err
    Path("study/d.tif").unlink()  # the stand-in finds balls only
    assert main(["segment", "study", *words]) == 0
    assert [row["file"] for row in read("t.csv")] == ["study/v.npz", "study/scan"]
    assert [row["unit"] for row in read("t.csv")] == ["", "mm"]
    page = Path("r.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 6
    assert "<small>mm³</small>" in page
