"""Tables of a run: what stands in which column, in pixels and in the caller's unit."""

from __future__ import annotations

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import segment
from cli.main import main
from cli.table import IMAGE_COLUMNS, OBJECT_COLUMNS


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two images, of a disc and of a ring with a disc cut by the border, and a damaged one between."""
    monkeypatch.chdir(tmp_path)
    row, col = np.indices((96, 128))

    def save(name: str, *shapes: tuple[float, float, float, float]) -> None:
        image = np.full(row.shape, 40.0)
        for r, c, radius, value in shapes:
            image += (value - image) * np.clip(radius - np.hypot(row - r, col - c) + 0.5, 0, 1)
        Image.fromarray(np.rint(image).astype(np.uint8)).save(name)

    save("a.png", (48.3, 60.6, 25.0, 200))
    (tmp_path / "b.png").write_bytes(b"no image")
    save("c.png", (48, 40, 30.0, 200), (48, 40, 15.0, 40), (40, 127, 20.0, 180))
    return tmp_path


def read(name: str) -> list[dict[str, str]]:
    with Path(name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_tables_of_images_and_objects(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["segment", ".", "--table", "t.csv", "--objects", "o.csv"]) == 2
    # no other file is written where only tables are asked for
    assert {path.name for path in folder.iterdir()} == {"a.png", "b.png", "c.png", "t.csv", "o.csv"}
    assert capsys.readouterr().out.splitlines()[-2:] == ["table       t.csv", "objects     o.csv"]
    disc, bad, two = read("t.csv")
    assert tuple(disc) == IMAGE_COLUMNS
    assert (disc["file"], disc["status"], disc["objects"], disc["message"]) == ("./a.png", "0", "1", "converged")
    area = np.pi * 25.0**2
    for name in ("area_total_px", "area_mean_px", "area_median_px"):
        assert float(disc[name]) == pytest.approx(area, rel=1e-3)
    assert float(disc["perimeter_total_px"]) == pytest.approx(2 * np.pi * 25.0, rel=1e-3)
    assert float(disc["contrast"]) == pytest.approx(160.0, rel=0.02)
    assert float(disc["edge_share"]) == pytest.approx(1.0, abs=0.01)
    assert 0 < float(disc["mean_uncertainty_px"]) <= float(disc["max_uncertainty_px"]) < 0.1
    assert float(disc["seconds"]) > 0
    assert int(disc["coefficients"]) > 0
    # without a spacing there is no unit, and an image has no volume
    assert {disc[name] for name in ("area_total", "perimeter_total", "volume_total_px", "surface_total")} == {""}
    assert (bad["status"], bad["area_total_px"], bad["objects"]) == ("2", "", "")
    assert "not an image" in bad["message"]
    assert (two["objects"], two["cut_by_border"]) == ("2", "1")
    assert float(two["border_share"]) > 0.05

    rows = read("o.csv")
    assert tuple(rows[0]) == OBJECT_COLUMNS
    assert [row["file"] for row in rows] == ["./a.png", "./c.png", "./c.png"]
    assert [row["label"] for row in rows] == ["1", "1", "2"]
    assert float(rows[0]["centroid_row"]) == pytest.approx(48.3, abs=0.02)
    assert float(rows[0]["centroid_col"]) == pytest.approx(60.6, abs=0.02)
    assert float(rows[0]["equivalent_diameter_px"]) == pytest.approx(50.0, rel=1e-3)
    assert float(rows[0]["circularity"]) == pytest.approx(1.0, abs=3e-3)
    assert float(rows[0]["box_col1"]) == pytest.approx(85.6, abs=0.1)
    assert rows[0]["centroid_plane"] == rows[0]["sphericity"] == rows[0]["area"] == ""
    assert {row["measured_on"] for row in rows} == {"contour"}
    ring = max(rows[1:], key=lambda row: int(row["holes"]))
    assert ring["holes"] == "1"
    assert float(ring["area_px"]) == pytest.approx(np.pi * (30.0**2 - 15.0**2), rel=2e-3)
    assert sorted(row["cut_by_border"] for row in rows[1:]) == ["0", "1"]


def test_a_spacing_gives_the_callers_unit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def spaced(image: Any, **options: Any) -> Any:
        return real(image, **{**options, "spacing": 0.5})

    real = segment.segment_image
    monkeypatch.setattr(segment, "segment_image", spaced)
    assert main(["segment", "a.png", "--table", "t.csv", "--objects", "o.csv", "--report", "r.html"]) == 0
    (row,), (one,) = read("t.csv"), read("o.csv")
    assert float(row["area_total"]) == pytest.approx(0.25 * float(row["area_total_px"]), rel=1e-8)
    assert float(row["perimeter_total"]) == pytest.approx(0.5 * float(row["perimeter_total_px"]), rel=1e-8)
    assert float(one["equivalent_diameter"]) == pytest.approx(25.0, rel=1e-3)
    # the T-mesh of the report is in pixels: its cells reach over the picture
    page = Path("r.html").read_text(encoding="utf-8")
    mesh = page.partition('class="mesh"')[2].partition("</")[0]
    assert "h12800" in mesh or "h12799" in mesh


def test_volumes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured on the mesh, shown in three cuts."""
    import trimesh

    from cli.batch import Outcome
    from cli.inputs import Input
    from cli.measured import Measured
    from cli.plates import plates_of
    from cli.run_files import parts_of

    ball = trimesh.creation.icosphere(4, 8.0)
    ball.apply_translation([10.0, 10.0, 10.0])
    place = np.moveaxis(np.indices((11, 21, 21)), 0, -1) * [2.0, 1.0, 1.0]
    mask = np.linalg.norm(place - 10.0, axis=-1) < 8.0
    result = SimpleNamespace(
        mask=mask, labels=mask.astype(np.int32), contours=[], contour_flags=[], contour_uncertainty=[], nit=4,
        field=SimpleNamespace(metadata={"spacing": [2.0, 1.0, 1.0]}, num_coefficients=99), num_components=1,
        to_mesh=lambda: ball,
    )  # fmt: skip
    image = np.where(mask, 9.0, 1.0)
    parts = parts_of(("table", "report"), Input("ball.npy"), image, result, None, Outcome(0, "converged"))
    row, (one,) = parts["table"], parts["objects"]
    assert row["volume_total"] == pytest.approx(4 / 3 * np.pi * 8.0**3, rel=3e-3)
    assert row["volume_total_px"] == pytest.approx(row["volume_total"] / 2, rel=1e-9)
    assert row["surface_total"] == pytest.approx(4 * np.pi * 8.0**2, rel=2e-3)
    assert "area_total_px" not in row
    assert {*row} <= set(IMAGE_COLUMNS)
    assert {*one} <= set(OBJECT_COLUMNS)
    assert one["sphericity"] == pytest.approx(1.0, abs=2e-3)
    assert one["centroid_plane"] == pytest.approx(5.0, abs=1e-6)
    assert one["measured_on"] == "surface"
    assert parts["report"].count("<svg") == 3
    assert "plane 5" in parts["report"]
    # a level set is cut where it is zero, the mask only between its pixels
    result.field = BallField()
    (first, _, _) = plates_of(Input("ball.npy"), image, result, None, Measured.of(result, image))
    (line,) = first.contours
    # values at the pixels, joined straight: an eighth of a pixel's square over the radius
    np.testing.assert_allclose(np.hypot(*(line - 10.0).T), 8.0, atol=0.02)


class BallField:
    """The distance to a sphere of radius 8 around (10, 10, 10), infinite beyond its box."""

    metadata: dict[str, Any] = {"spacing": [2.0, 1.0, 1.0]}  # noqa: RUF012
    num_coefficients = 1

    def __call__(self, points: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - 10.0, axis=1) - 8.0
        return np.where(distance < 5.0, distance, np.inf)


def test_a_table_is_complete_or_absent(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(image: Any, **options: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(segment, "segment_image", interrupted)
    words = ["segment", "a.png", "--table", "t.csv", "--objects", "o.csv", "--report", "r.html"]
    assert main(words) == 130
    assert {path.name for path in folder.iterdir()} == {"a.png", "b.png", "c.png"}
    Path("t.csv").write_text("mine")
    assert main(words) == 2
    assert Path("t.csv").read_text() == "mine"


def test_a_table_on_standard_output(folder: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert main(["segment", "a.png", "--table", "-"]) == 0
    said = capfdbinary.readouterr()
    head, row = said.out.decode().splitlines()
    assert head.split(",") == list(IMAGE_COLUMNS)
    assert row.startswith("a.png,0,converged,")
    assert b"a.png: 1 object" in said.err
