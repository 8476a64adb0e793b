"""``tspline segment`` and ``info`` on volumes: what is read, passed on and written; the solver is a stand-in."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import nibabel
import nrrd
import numpy as np
import pytest
import tifffile
import trimesh
from dicom_maker import write_series
from PIL import Image

import segment
from cli.main import main
from tspline import TMesh, TSpline

CENTER = np.array([8.0, 7.0, 9.0])
RADIUS = 4.0
"""Of the ball that the stand-in finds, in indices (plane, row, column)."""
SHAPE = (16, 17, 18)
GREY = np.random.default_rng(1).integers(0, 255, SHAPE).astype(np.uint8)
OBLIQUE = np.array([[0.0, -2.0, 0.6, 5.0], [1.5, 0.0, 0.0, -7.0], [0.0, 0.6, 2.0, 11.0], [0.0, 0.0, 0.0, 1.0]])
"""Takes (column, row, plane) to RAS; orthogonal columns, mirrored."""


def found_ball(image: Any, *, spacing: Any = None, callback: Any = None, **options: Any) -> SimpleNamespace:
    """A ball of `RADIUS` samples around `CENTER`, as a T-spline over spacing * index."""
    shape = np.asarray(image).shape[:3]
    sides = np.ones(3) if spacing is None else np.asarray(spacing)
    index = np.stack(np.indices(shape), axis=-1)
    mask = np.linalg.norm(index - CENTER, axis=-1) < RADIUS
    half = 1.3 * RADIUS * sides.max()
    mesh = TMesh.uniform(np.stack([CENTER * sides - half, CENTER * sides + half]), 3)
    # a quadratic is in the spline space: the zero set is the ellipsoid to rounding
    fitted = TSpline.fit(mesh, lambda x: np.sum((x / sides - CENTER) ** 2, axis=1) - RADIUS**2)
    field = TSpline(mesh, fitted.coefficients, {"spacing": sides.tolist()})
    return SimpleNamespace(
        mask=mask, labels=mask.astype(np.int32), contours=[], contour_flags=[], field=field, spline=field, success=True,
        status=0, message="fake", nit=1, history=[], num_components=1, warnings=[], to_mesh=field.to_mesh,
        classes=None,
    )  # fmt: skip


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A current folder with volumes, and the calls of the stand-in."""
    monkeypatch.chdir(tmp_path)
    nibabel.save(nibabel.Nifti1Image(GREY.T, OBLIQUE), "vol.nii.gz")
    np.save("vol.npy", GREY)
    Image.fromarray(GREY[0]).save("flat.png")
    made: list[dict[str, Any]] = []

    def segment_image(image: Any, **options: Any) -> SimpleNamespace:
        made.append({"image": image, **options})
        return found_ball(image, **options)

    monkeypatch.setattr(segment, "segment_image", segment_image)
    return made


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(list(words)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def ball_in(affine: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance in samples from the ball's centre, of world points under an affine of (column, row, plane)."""
    index = np.linalg.solve(affine[:3, :3], (points - affine[:3, 3]).T).T
    return np.asarray(np.linalg.norm(index - CENTER[::-1], axis=1))


@pytest.mark.parametrize("ending", [".ply", ".stl", ".obj", ".glb", ".3mf"])
def test_meshes_are_in_the_world_of_the_file(calls: list[dict[str, Any]], ending: str) -> None:
    assert main(["segment", "vol.nii.gz", "--mesh", f"m{ending}"]) == 0
    np.testing.assert_array_equal(calls[0]["image"], GREY)
    np.testing.assert_allclose(calls[0]["spacing"], np.linalg.norm(OBLIQUE[:3, 2::-1], axis=0), rtol=1e-6)
    assert calls[0]["channel_axis"] is None
    if ending == ".3mf":
        return  # trimesh needs a package more to read it
    mesh = trimesh.load(f"m{ending}", force="mesh")
    points = mesh.vertices * (1000.0 if ending == ".glb" else 1.0)  # GLB is in metres
    np.testing.assert_allclose(ball_in(OBLIQUE, points), RADIUS, atol=0.01)
    assert mesh.is_watertight
    assert mesh.volume > 0  # outward, although the affine mirrors
    if ending == ".ply":
        head = Path("m.ply").read_bytes().partition(b"end_header")[0]
        assert b"comment units: millimeter\ncomment SPACE=RAS\n" in head
        toward = np.einsum("ij,ij->i", mesh.vertex_normals, mesh.vertices - mesh.centroid)
        assert toward.min() > 0
    if ending == ".stl":
        assert Path("m.stl").read_bytes()[:17] == b"tspline SPACE=RAS"


@pytest.mark.parametrize("ending", [".nii", ".nii.gz", ".nrrd", ".tif", ".npz", ".npy"])
def test_masks_and_labels_of_volumes(calls: list[dict[str, Any]], ending: str) -> None:
    assert main(["segment", "vol.nii.gz", "--mask", f"m{ending}", "--labels", f"l{ending}"]) == 0
    wanted = found_ball(GREY).mask
    for name, top in (("m", 255 if ending == ".tif" else 1), ("l", 1)):
        path = f"{name}{ending}"
        if ending.startswith(".nii"):
            image = nibabel.load(path)
            data = np.asarray(image.dataobj).T
            np.testing.assert_allclose(image.affine, nibabel.load("vol.nii.gz").affine)
        elif ending == ".nrrd":
            data = nrrd.read(path)[0].T
        elif ending == ".tif":
            data = tifffile.imread(path)
        else:
            data = np.load(path)
            data = data[data.files[0]] if ending == ".npz" else data
        np.testing.assert_array_equal(data, top * wanted)


def test_a_dicom_folder(calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]) -> None:
    steps = np.array([[0.0, 0.0, 1.5], [0.0, 2.0, 0.0], [-3.0, 0.0, 0.0]])
    write_series(Path("scan.1"), GREY.astype(np.int16), steps, np.array([5.0, 6.0, 7.0]))
    assert main(["segment", "scan.1", "--mask", "{stem}.nii.gz", "--mesh", "m.ply", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["dim"], record["shape"], record["spacing"]) == (3, list(SHAPE), [3.0, 2.0, 1.5])
    assert (record["unit"], record["world"], record["genus"]) == ("mm", "LPS", 0)
    assert record["volume"] == pytest.approx(4 / 3 * np.pi * RADIUS**3 * 9.0, rel=0.01)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = steps[:, ::-1], (5.0, 6.0, 7.0)
    # the planes run against the normal of rows and columns, and are turned
    mesh = trimesh.load("m.ply", force="mesh")
    assert np.isfinite(mesh.vertices).all()
    turned = affine.copy()
    turned[:3, 2], turned[:3, 3] = -affine[:3, 2], affine[:3, 3] + (SHAPE[0] - 1) * affine[:3, 2]
    np.testing.assert_allclose(ball_in(turned, mesh.vertices), RADIUS, atol=0.01)
    image = nibabel.load("scan.1.nii.gz")
    np.testing.assert_allclose(image.affine, np.diag([-1, -1, 1, 1]) @ turned, atol=1e-5)


def test_options_reach_the_segmentation(calls: list[dict[str, Any]]) -> None:
    roi = np.zeros(SHAPE, bool)
    roi[3:9] = True
    nibabel.save(nibabel.Nifti1Image(roi.T.astype(np.uint8), OBLIQUE), "roi.nii")
    np.savez("start.npz", mask=roi, image=GREY)
    words = ["--seeds", "1,2,3", "4,5,6.5", "--box", "0,1,2,9,8,7", "--roi", "roi.nii", "--spacing", "3,2,1"]
    assert main(["segment", "vol.nii.gz", *words, "--mask", "m.nii"]) == 0
    (call,) = calls
    assert call["seeds"] == [(1.0, 2.0, 3.0), (4.0, 5.0, 6.5)]
    assert call["init"] == (0.0, 1.0, 2.0, 9.0, 8.0, 7.0)
    np.testing.assert_array_equal(call["roi"], roi)
    np.testing.assert_allclose(call["spacing"], (3.0, 2.0, 1.0))
    image = nibabel.load("m.nii")
    np.testing.assert_allclose(np.linalg.norm(image.affine[:3, :3], axis=0), (1.0, 2.0, 3.0), rtol=1e-6)
    assert main(["segment", "vol.npy", "--init", "start.npz", "--spacing", "2", "--mask", "n.npy"]) == 0
    np.testing.assert_array_equal(calls[1]["init"], roi)
    assert calls[1]["spacing"] == (2.0, 2.0, 2.0)
    assert main(["segment", "vol.npy", "--mask", "o.npy"]) == 0
    assert calls[2]["spacing"] is None


def test_channels(calls: list[dict[str, Any]]) -> None:
    np.save("two.npy", np.stack([GREY, GREY]))
    assert main(["segment", "two.npy", "--channel-axis", "0", "--mask", "m.npy"]) == 0
    assert calls[0]["image"].shape == (*SHAPE, 2)
    assert calls[0]["channel_axis"] == 3


def test_without_options_a_model_and_a_figure(
    calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = {path.name for path in tmp_path.iterdir()}
    assert main(["segment", "vol.nii.gz"]) == 0
    assert {path.name for path in tmp_path.iterdir()} - before == {"vol.tsp.npz", "vol.png"}
    with Image.open("vol.png") as figure:
        assert figure.width > 1000


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("vol.nii.gz --contour c.svg", "vol.nii.gz: --contour is not for a volume; accepted is --mesh"),
        ("vol.nii.gz --animation a.gif", "--animation is not for a volume; accepted is --figure"),
        ("flat.png --mesh m.ply", "flat.png: --mesh is not for an image; accepted is --contour"),
        ("vol.nii.gz --mask m.png", "--mask m.png: found '.png' for a volume; accepted is a file .nii.gz"),
        ("vol.nii.gz --labels m.nhdr", "the ending '.nhdr'"),
        ("vol.npy --seeds 1,2", "vol.npy: --seeds 1,2: found a volume; accepted is p,r,c"),
        ("flat.png --seeds 1,2,3", "flat.png: --seeds 1,2,3: found an image; accepted is r,c"),
        ("vol.npy --box 1,2,3,4", "--box of 4 numbers: found a volume; accepted is p0,r0,c0,p1,r1,c1"),
        ("vol.npy --box 1,2,3,1,5,6", "p0 < p1 and r0 < r1 and c0 < c1"),
        ("vol.npy --spacing 1,2", "--spacing has 2 lengths; accepted is 1 or 3"),
        ("vol.npy --spacing 1,2,0", "'1,2,0'; accepted is 1 to 3 lengths above 0"),
        ("vol.npy --channel-axis x", "'x'; accepted is the number of an axis"),
        ("vol.npy --channel-axis 7", "without the channel axis 7"),
        ("vol.npy --roi flat.png", "flat.png: a mask of 17 x 18 pixels; accepted is the image's size, 16 x 17 x 18"),
        ("vol.npy --roi none.nii", "--roi none.nii: No such file"),
    ],
)
def test_wrong_usage(calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], words: str, told: str) -> None:
    assert told in refused(capsys, "segment", *words.split(), *([] if "--m" in words else ["--model", "s.npz"]))
    assert not calls


def test_outputs_without_their_package(
    calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import importlib.util

    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "nibabel" else found(name))
    line = refused(capsys, "segment", "vol.npy", "--mask", "m.nii.gz")
    assert "m.nii.gz: .nii.gz needs the package nibabel: pip install 'tspline[medical]'" in line


def test_no_surface_is_told(
    calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(image: Any, **options: Any) -> SimpleNamespace:
        result = found_ball(image, **options)
        result.num_components = 0
        return result

    monkeypatch.setattr(segment, "segment_image", nothing)
    assert main(["segment", "vol.npy", "--mesh", "m.ply"]) == 1
    assert "there is no surface to write" in capsys.readouterr().err
    assert not Path("m.ply").exists()


def test_info(calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]) -> None:
    write_series(Path("scan"), GREY.astype(np.int16), np.eye(3)[:, ::-1] * [3.0, 2.0, 1.5], np.zeros(3))
    tifffile.imwrite(
        "s.tif", GREY, imagej=True, resolution=(4.0, 4.0), metadata={"axes": "ZYX", "spacing": 2.0, "unit": "um"}
    )
    np.savez("a.npz", image=GREY, mask=GREY > 9)
    assert main(["info", "vol.nii.gz", "scan", "s.tif", "a.npz", "vol.npy", "flat.png", "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["kind"] for record in records] == ["volume"] * 5 + ["image"]
    assert [record["format"] for record in records] == ["NIfTI", "DICOM", "TIFF", "NumPy", "NumPy", "image"]
    assert all(record["shape"] == list(SHAPE) for record in records[:5])
    np.testing.assert_allclose(records[0]["spacing"], np.linalg.norm(OBLIQUE[:3, 2::-1], axis=0), rtol=1e-6)
    np.testing.assert_allclose(records[0]["affine"], OBLIQUE, atol=1e-6)
    assert (records[0]["world"], records[1]["world"], records[2]["unit"]) == ("RAS", "LPS", "um")
    assert records[3]["spacing"] is None
    assert main(["info", "scan"]) == 0
    told = capsys.readouterr().out
    assert "scan: DICOM volume, 16 × 17 × 18 samples, int16" in told
    assert "3 × 2 × 1.5 mm (plane, row, column)" in told


def test_physical_contours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real solver, on a disc in an image with a spacing."""
    monkeypatch.chdir(tmp_path)
    index = np.indices((64, 72))
    disc = np.where(np.hypot(index[0] - 30, index[1] - 36) < 14, 200, 40).astype(np.uint8)
    tifffile.imwrite("d.tif", disc, imagej=True, resolution=(4.0, 4.0), metadata={"unit": "micron"})
    words = ["--contour", "c.geojson", "--model", "s.tsp.npz", "--mask", "m.tif", "--figure", "f.png"]
    assert main(["segment", "d.tif", *words]) == 0
    (feature,) = json.loads(Path("c.geojson").read_text())["features"]
    ring = np.array(feature["geometry"]["coordinates"][0])
    # pixel centres inside a disc of 14 give a contour of about 14, columns first
    np.testing.assert_allclose(np.hypot(ring[:, 0] - 9.0, ring[:, 1] - 7.5), 3.5, atol=0.15)
    assert (feature["properties"]["unit"], feature["properties"]["spacing"]) == ("um", [0.25, 0.25])
    import tspline

    curve = tspline.load("s.tsp.npz").to_polylines()[0]
    np.testing.assert_allclose(np.hypot(curve[:, 0] - 7.5, curve[:, 1] - 9.0), 3.5, atol=0.15)
    with tifffile.TiffFile("m.tif") as file:
        assert file.imagej_metadata["unit"] == "micron"
        assert file.pages.first.tags["XResolution"].value == (4, 1)
    for name in ("c.svg", "c.dxf"):
        assert main(["segment", "d.tif", "--contour", name]) == 0
    assert 'viewBox="0 0 72 64"' in Path("c.svg").read_text()
    import ezdxf

    document = ezdxf.readfile("c.dxf")
    assert document.units == 13
    (line,) = document.modelspace()
    points = np.array([point[:2] for point in line.get_points()])
    np.testing.assert_allclose(np.hypot(points[:, 0] - 9.0, points[:, 1] - (63 - 30) * 0.25), 3.5, atol=0.15)


def test_series_in_folders_are_one_input_each(calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]) -> None:
    Path("study").mkdir()
    for name in ("a.1", "b.2"):
        write_series(Path("study") / name, GREY.astype(np.int16), np.eye(3)[:, ::-1] * [3.0, 2.0, 1.5], np.zeros(3))
    words = ["--mask", "{stem}.npy", "--table", "sizes.csv", "--json"]
    assert main(["segment", "study/a.1", *words]) == 0
    (record,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert (record["input"], record["outputs"]["mask"]) == ("study/a.1", "a.1.npy")
    rows = Path("sizes.csv").read_text().splitlines()
    assert "volume_total" in rows[0]
    assert main(["segment", "study", "--recursive", "--model", "{stem}.tsp.npz"]) == 0
    assert len(calls) == 3
    assert Path("a.1.tsp.npz").exists()
    assert Path("b.2.tsp.npz").exists()
