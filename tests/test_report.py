"""The report: one page that loads nothing, with lines where the contours are, and a slider that moves them."""

from __future__ import annotations

import base64
import io
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cli.main import main
from tspline.figure.page import Document, Frame, Plate
from tspline.figure.page.paths import class_paths, closed_path, mesh_path
from tspline.figure.page.picture import MAX_SIDE, data_uri
from tspline.figure.page.plate import MAX_FRAMES

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
VOID = {"meta", "input", "br", "image", "link", "img", "path"}


def circle(row: float, col: float, radius: float, count: int = 400) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.stack([row + radius * np.cos(angle), col + radius * np.sin(angle)], axis=1)


def points_of(data: str) -> list[np.ndarray]:
    """Vertices in pixels of path data: an absolute start and relative steps."""
    found = []
    for part in data.split("M")[1:]:
        start, _, steps = part.rstrip("z").partition("l")
        numbers = np.array(re.findall(r"-?\d+", steps), dtype=int).reshape(-1, 2)
        found.append(np.cumsum(np.vstack([np.array(start.split(), dtype=int)[None], numbers]), axis=0) / 100)
    return found


class Elements(HTMLParser):
    """Elements with their attributes; open and close tags have to match."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


def test_lines_stay_within_hundredths_of_a_pixel() -> None:
    line = circle(40.3, 70.7, 20.0)[:, ::-1]
    (points,) = points_of(closed_path([line]))
    assert 20 < len(points) < 200  # thinned
    radius = np.hypot(*(points - [70.7, 40.3]).T)
    np.testing.assert_allclose(radius, 20.0, atol=0.01)
    middle = 0.5 * (points + np.roll(points, -1, axis=0))
    np.testing.assert_allclose(np.hypot(*(middle - [70.7, 40.3]).T), 20.0, atol=0.03)


def test_pieces_by_class_cover_the_line_and_share_their_ends() -> None:
    line = circle(10.0, 10.0, 8.0, 100)
    classes = np.repeat([2, -1, 5, 2], 25)
    found = class_paths([line, circle(30.0, 30.0, 5.0, 60)], [classes, np.full(60, 5)])
    assert list(found) == [-1, 2, 5]
    assert found[5].endswith("z")  # a whole line of one class is closed
    pieces = [points_of(found[kind]) for kind in (-1, 2)]
    # 2 runs over the end of the line: one piece of 50 from point 75 to 25, where the piece of -1 begins
    assert [len(piece) for piece in pieces] == [1, 1]
    np.testing.assert_allclose(pieces[1][0][-1], pieces[0][0][0])
    np.testing.assert_allclose(pieces[1][0][0], line[75], atol=0.005)


def test_a_mesh_is_drawn_side_by_side_once_and_within_the_picture() -> None:
    corner = np.stack(np.meshgrid(np.arange(-2, 4), np.arange(-2, 4), indexing="ij"), axis=-1).reshape(-1, 2)
    cells = np.stack([corner, corner + 1], axis=1).astype(float)
    data = mesh_path(cells, (3.0, 2.0))
    assert sorted(re.findall(r"M(\d+) (\d+)([hv])(\d+)", data)) == sorted(
        [("0", str(100 * k), "h", "300") for k in range(3)] + [(str(100 * k), "0", "v", "200") for k in range(4)]
    )


@pytest.mark.parametrize(("shape", "kind"), [((20, 30), "png"), ((20, 30, 3), "png"), ((900, 1000, 3), "jpeg")])
def test_images_are_embedded_at_a_sensible_size(shape: tuple[int, ...], kind: str, rng: np.random.Generator) -> None:
    uri = data_uri(rng.integers(0, 60000, shape).astype(np.uint16))
    head, _, data = uri.partition(";base64,")
    assert head == f"data:image/{kind}"
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        assert picture.size == (shape[1], shape[0])


def test_large_images_are_made_smaller() -> None:
    wide = np.zeros((300, 5000))
    wide[:, 2500:] = 1.0
    with Image.open(io.BytesIO(base64.b64decode(data_uri(wide).partition(",")[2]))) as picture:
        assert picture.size == (MAX_SIDE, 96)
        np.testing.assert_array_equal(np.asarray(picture)[:, [0, 799, 800, -1]], np.tile([0, 0, 255, 255], (96, 1)))


def plate(frames: int = 3) -> Plate:
    return Plate(
        np.arange(600.0).reshape(20, 30),
        'a <b>"plate"</b>',
        [circle(10.0, 15.0, 6.0)],
        [np.where(np.arange(400) < 300, 0.02, np.inf)],
        np.array([[[0.0, 0.0], [8.0, 8.0]]]),
        [Frame(f"step {k} <", [circle(10.0, 15.0, 9.0 - k / frames)]) for k in range(frames)],
        [("7", (10.0, 15.0))],
    )


def test_a_plate_holds_its_layers_where_pixels_are() -> None:
    """The centre of pixel (row, col) is (col + 0.5, row + 0.5) of the drawing."""
    found = Elements(plate().html()).found
    (svg,) = (attributes for tag, attributes in found if tag == "svg")
    assert svg["viewbox"] == "0 0 30 20"
    paths = [attributes for tag, attributes in found if tag == "path"]
    (whole,) = points_of(next(one["d"] or "" for one in paths if one.get("class") == "plain"))
    np.testing.assert_allclose(np.hypot(*(whole - [15.5, 10.5]).T), 6.0, atol=0.01)
    assert len([one for one in paths if one.get("class") == "sure"]) == 2  # on an edge, and on none
    assert [one["data-label"] for one in paths if "data-label" in one] == ["step 0 <", "step 1 <", "step 2 <"]
    (mesh,) = (one for one in paths if one.get("class") == "mesh")
    assert mesh["d"] == "M50 50h800M50 850h800M50 50v800M850 50v800"
    (name,) = (attributes for tag, attributes in found if tag == "text")
    assert (name["x"], name["y"]) == ("15.50", "10.50")
    (slider,) = (one for tag, one in found if tag == "input" and one.get("type") == "range")
    assert (slider["max"], slider["value"]) == ("3", "3")
    assert "<b>" not in plate().html().partition("</title>")[0]


def test_pixels_that_are_no_squares_keep_their_proportions() -> None:
    page = Plate(np.zeros((10, 30)), "tall pixels", [], pitch=(2.5, 0.5)).html()
    assert 'viewBox="0 0 30 50"' in page
    assert '<g transform="scale(1 5)">' in page


def test_frames_are_thinned_evenly() -> None:
    labels = re.findall(r'data-label="step (\d+) ', plate(200).html())
    assert len(labels) == MAX_FRAMES
    assert (labels[0], labels[-1]) == ("0", "199")


def test_nothing_known_and_nothing_found() -> None:
    page = Plate(np.zeros((9, 9)), "empty", []).html()
    assert "legend" not in page
    assert 'type="range"' not in page
    assert 'class="of-colours"' not in page
    Elements(page)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two images, one seen while a circle shrinks, and one that is damaged."""
    folder = tmp_path_factory.mktemp("report")
    row, col = np.indices((48, 64))
    disc = np.where(np.hypot(row - 24, col - 32) < 11, 210, 30).astype(np.uint8)
    Image.fromarray(disc).save(folder / "a & b.png")
    (folder / "c.png").write_bytes(b"no image")
    path = folder / "r.html"
    words = [str(folder / "a & b.png"), str(folder / "c.png"), "--init", "circle", "--report", str(path), "--quiet"]
    assert main(["segment", *words]) == 2
    return path


def test_the_page_is_whole_and_loads_nothing(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    found = Elements(page).found
    assert "http:" not in page
    assert "https:" not in page
    assert "url(" not in page
    assert "@import" not in page
    for tag, attributes in found:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        assert "src" not in attributes
        href = attributes.get("href")
        assert href is None or href.startswith(("#image-", "data:image/"))
        assert not any(name.startswith("on") for name in attributes)
    anchors = {attributes["href"] for tag, attributes in found if tag == "a"}
    assert anchors == {"#" + str(attributes["id"]) for tag, attributes in found if tag == "section"}
    assert sum(tag == "svg" for tag, _ in found) == 1
    assert "a &amp; b.png" in page
    assert "not an image of a known kind" in page
    assert "init circle" in page
    assert "prefers-color-scheme: dark" in page
    steps = page.count("data-label=")
    assert 10 < steps <= MAX_FRAMES
    assert len(page) < 200_000


def test_a_document_is_the_same_in_pieces() -> None:
    document = Document("a < b", "<p>head</p>", "<p>foot</p>")
    page = document.html(["<p>one</p>", "<p>two</p>"])
    before, after = document.pieces()
    assert page == before + "<p>one</p><p>two</p>" + after
    assert "<title>a &lt; b</title>" in page
    Elements(page)


@pytest.fixture
def browser(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[bytes]]:
    """Chromium without a window: what it prints, and its log."""
    if CHROMIUM is None:
        pytest.skip("needs chromium on the PATH")

    def run(page: str, *options: str) -> subprocess.CompletedProcess[bytes]:
        words = [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr",
            "--window-size=900,900", "--virtual-time-budget=1000", f"--user-data-dir={tmp_path / 'profile'}",
        ]  # fmt: skip
        return subprocess.run([*words, *options, page], capture_output=True, timeout=120, check=True)

    return run


def test_the_slider_moves_the_contour_in_a_browser(
    report: Path, tmp_path: Path, browser: Callable[..., subprocess.CompletedProcess[bytes]]
) -> None:
    """The address asks for a step; the script shows that step's line and no other, and the picture changes."""
    ran = browser(f"{report.as_uri()}#step=3", "--dump-dom")
    assert b"CONSOLE" not in ran.stderr, ran.stderr
    found = Elements(ran.stdout.decode()).found
    (view,) = (one for tag, one in found if tag == "figure")
    assert view["data-step"] == "3"
    assert "moving" in (view["class"] or "").split()
    frames = [one for tag, one in found if tag == "path" and "data-label" in one]
    assert [number for number, one in enumerate(frames) if one.get("class") == "shown"] == [3]
    (halo,) = (one for tag, one in found if tag == "path" and "halo" in (one.get("class") or ""))
    assert halo["d"] == frames[3]["d"]
    pictures = []
    for name, step in (("first", "0"), ("last", "999")):
        path = tmp_path / f"{name}.png"
        browser(f"{report.as_uri()}#step={step}", f"--screenshot={path}")
        with Image.open(path) as picture:
            pictures.append(np.asarray(picture.convert("RGB")).astype(int))
    first, last = pictures
    changed = np.abs(first - last).max(axis=2) > 60
    # both lines, the circle around the image and that around the disc, and nothing like all of the page
    assert 500 < np.count_nonzero(changed) < 0.1 * changed.size
