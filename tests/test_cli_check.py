"""``tspline check``: what it runs, says and draws; the solvers are stand-ins with known shapes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import recon
import segment
from cli.main import main
from tspline import TMesh, TSpline
from tspline.errors import InvalidArgumentError
from tspline.grid import Grid, GridField

CALLS: list[dict[str, Any]] = []
RADII = {"tspline": 12.0, "grid": 12.2}
STATUS = {"tspline": 0, "grid": 0}


def field(solver: str, bounds: np.ndarray, middle: np.ndarray, radius: float) -> TSpline | GridField:
    """A ball or a disc, in a domain of the solver's own."""

    def f(x: np.ndarray) -> np.ndarray:
        value: np.ndarray = (np.sum((x - middle) ** 2, axis=1) - radius**2) / (2.0 * radius)
        return value

    if solver == "tspline":
        return TSpline.fit(TMesh.uniform(bounds, 4), f)
    cells = 40 if len(middle) == 2 else 20
    grid = Grid([cells + 1] * len(middle), (bounds[1] - bounds[0]) / cells, bounds[0])
    return GridField.from_function(grid, f)


def result(solver: str, held: TSpline | GridField) -> SimpleNamespace:
    status = STATUS[solver]
    return SimpleNamespace(
        field=held, status=status, success=status == 0, message=f"ended {status}", warnings=[f"note of {solver}"]
    )


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    CALLS.clear()
    monkeypatch.setitem(RADII, "grid", 12.2)
    monkeypatch.setitem(STATUS, "grid", 0)
    image = np.random.default_rng(3).integers(0, 255, (40, 60), dtype=np.uint8)
    Image.fromarray(image).save("coin.png")
    np.save("array.npy", image)
    angle = np.linspace(0, 6.2, 80)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    np.savetxt("ring.csv", ring, delimiter=",")
    np.savetxt("flat.xyz", np.column_stack([ring, np.full(80, 2.0)]))
    np.save("ring.npy", ring)
    np.savetxt("ball.xyz", np.random.default_rng(4).normal(size=(50, 3)))

    def segment_image(image: np.ndarray, **options: Any) -> SimpleNamespace:
        CALLS.append(options)
        bounds = np.array([[-5.0, 0.0], [45.0, 50.0]])
        solver = options["solver"]
        return result(solver, field(solver, bounds, np.array([20.0, 25.0]), RADII[solver]))

    def fit_points(points: np.ndarray, **options: Any) -> SimpleNamespace:
        CALLS.append({"shape": points.shape, **options})
        solver, dim = options["solver"], points.shape[1]
        bounds = np.array([[-1.6] * dim, [1.6] * dim])
        return result(solver, field(solver, bounds, np.zeros(dim), RADII[solver] / 12.0))

    monkeypatch.setattr(segment, "segment_image", segment_image)
    monkeypatch.setattr(recon, "fit_points", fit_points)
    return tmp_path


def record(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> dict[str, Any]:
    """The one line of JSON that the command prints."""
    assert main(["check", *words, "--json", "--quiet"]) == status
    (line,) = capsys.readouterr().out.splitlines()
    told: dict[str, Any] = json.loads(line)
    return told


def test_an_image_is_solved_twice_and_told_in_pixels(capsys: pytest.CaptureFixture[str]) -> None:
    before = set(Path().iterdir())
    assert main(["check", "coin.png", "--depth", "5"]) == 0
    said = capsys.readouterr()
    assert set(Path().iterdir()) == before
    assert [call["solver"] for call in CALLS] == ["tspline", "grid"]
    assert all(call["max_depth"] == 5 and call["channel_axis"] is None for call in CALLS)
    lines = said.out.splitlines()
    assert lines[0] == "coin.png: both results agree"
    assert lines[1].split() == ["T-spline", "grid"]
    assert any(line.split() == ["curves", "1", "1"] for line in lines)
    assert lines[-1].startswith("  IoU 0.967")
    assert lines[-1].endswith("(in pixels)")
    assert "warning: coin.png: the T-spline: note of tspline" in said.err
    assert "warning: coin.png: the grid: note of grid" in said.err


def test_the_record_has_what_is_promised(capsys: pytest.CaptureFixture[str]) -> None:
    told = record(capsys, "coin.png")
    assert told["schema"] == 1
    assert told["command"] == "check"
    assert told["status"] == 0
    assert told["seconds"] >= sum(told["solver_seconds"])
    assert told["iou"] == pytest.approx((12.0 / 12.2) ** 2, abs=1e-5)
    assert told["mean_distance"] == pytest.approx(0.2, abs=0.01)
    assert told["max_distance"] == pytest.approx(0.2, abs=0.02)
    assert told["components"] == [1, 1]
    assert len(told["num_coefficients"]) == 2
    assert told["agrees"] is True
    assert told["differences"] == []
    assert told["unit"] == "pixels"


def test_disagreement_is_told_and_is_no_failure(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(RADII, "grid", 17.0)
    assert main(["check", "coin.png", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["check", "coin.png"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("coin.png: the results disagree\n")
    assert "  disagree: furthest apart 5 at (" in out
    assert record(capsys, "coin.png")["agrees"] is False


def test_an_empty_result_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(image: np.ndarray, *, solver: str, **options: Any) -> SimpleNamespace:
        held = field(solver, np.array([[0.0, 0.0], [9.0, 9.0]]), np.array([4.0, 4.0]), 2.0)
        if solver == "grid":
            held = GridField(Grid((9, 9)), np.ones((9, 9)))
        return result(solver, held)

    monkeypatch.setattr(segment, "segment_image", nothing)
    monkeypatch.setitem(STATUS, "grid", 2)
    told = record(capsys, "coin.png", "--figure", "f.png", status=3)
    assert told["iou"] == 0.0
    assert told["mean_distance"] is None
    assert told["differences"] == ["the grid is empty"]
    assert Path("f.png").is_file()


def test_not_converged(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STATUS, "grid", 1)
    assert main(["check", "coin.png", "ring.csv"]) == 3
    said = capsys.readouterr()
    assert "not converged: the grid: ended 1" in said.out
    assert "2 inputs: 2 not converged" in said.err
    assert record(capsys, "coin.png", status=3)["solver_status"] == [0, 1]


@pytest.mark.parametrize(("name", "shape"), [("ring.csv", (80, 2)), ("flat.xyz", (80, 2)), ("ring.npy", (80, 2))])
def test_points_in_the_plane(name: str, shape: tuple[int, int], capsys: pytest.CaptureFixture[str]) -> None:
    told = record(capsys, name)
    assert [call["shape"] for call in CALLS] == [shape, shape]
    assert told["unit"] is None
    assert told["genus"] is None


def test_points_in_space(capsys: pytest.CaptureFixture[str]) -> None:
    told = record(capsys, "ball.xyz", "--figure", "ball.png")
    assert told["genus"] == [0, 0]
    assert told["dim"] == 3
    assert told["outputs"] == {"figure": "ball.png"}
    with Image.open("ball.png") as figure:
        assert figure.width > 1000


def test_an_array_that_is_no_list_of_points_is_an_image(capsys: pytest.CaptureFixture[str]) -> None:
    assert record(capsys, "array.npy")["unit"] == "pixels"


@pytest.mark.parametrize("name", ["coin.png", "ring.csv"])
def test_a_figure_is_replaced_only_by_force(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", name, "--figure", "f.png"]) == 0
    said = capsys.readouterr().out
    assert "f.png" in said
    assert main(["check", name, "--figure", "f.png"]) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["check", name, "--figure", "f.png", "--force"]) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "found no IMAGE or POINTS"),
        (["-"], "standard input has no name"),
        (["gone.png"], "gone.png: No such file"),
        (["gone.csv"], "gone.csv: No such file"),
        (["gone.npy"], "gone.npy: No such file"),
        (["bad.png"], "bad.png: "),
        (["what.doc"], "what.doc: the ending '.doc'; accepted is .ply"),
        (["coin.png", "--figure", "f.gif"], "--figure f.gif: found the ending '.gif'"),
        (["coin.png", "--depth", "99"], "found '99'"),
    ],
)
def test_wrong_input_is_one_line(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("bad.png").write_bytes(b"no image")
    assert main(["check", *words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert told in line
    assert CALLS == []


def test_an_error_of_a_solver_names_the_file(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(points: np.ndarray, **options: Any) -> None:
        raise InvalidArgumentError("points", "3 points", "at least 4")

    monkeypatch.setattr(recon, "fit_points", refuse)
    assert main(["check", "ring.csv"]) == 2
    assert "ring.csv: points: found 3 points" in capsys.readouterr().err
