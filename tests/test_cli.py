"""The command: what it writes, where, and what it says; the solvers are stand-ins."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import types
from pathlib import Path

import fake_solver
import numpy as np
import pytest
from PIL import Image

import recon
import segment
from cli.main import COMMANDS, main
from segment.image_file import write_mask

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with an image and points, and stand-ins that remember their options."""
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.random.default_rng(3).integers(0, 255, (40, 60), dtype=np.uint8)).save("coin.png")
    angle = np.linspace(0, 6.2, 80)
    np.savetxt("ring.csv", np.column_stack([np.cos(angle), np.sin(angle)]), delimiter=",", header="x,y")
    calls: list[dict[str, object]] = []

    def segment_image(image: object, **options: object) -> object:
        calls.append({"image": image, **options})
        return fake_solver.segment_image(image, **options)

    def fit_points(points: object, **options: object) -> object:
        calls.append({"points": points, **options})
        return fake_solver.fit_points(points, **options)

    monkeypatch.setattr(segment, "segment_image", segment_image, raising=False)
    monkeypatch.setattr(recon, "fit_points", fit_points, raising=False)
    monkeypatch.setattr(pytest, "solver_calls", calls, raising=False)
    return tmp_path


def calls() -> list[dict[str, object]]:
    return pytest.solver_calls  # type: ignore[attr-defined, no-any-return]


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"coin.png", "ring.csv"}


def test_segment_without_options_writes_a_model_and_a_figure(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["segment", "coin.png"]) == 0
    # coin.png is the input: both names get a number, so that the pair stays together
    assert names(folder) == {"coin-1.tsp.npz", "coin-1.png"}
    said = capsys.readouterr().out
    assert "coin-1.tsp.npz" in said
    assert "coin-1.png" in said
    assert main(["segment", "coin.png", "--quiet"]) == 0
    assert {"coin-2.tsp.npz", "coin-2.png"} < names(folder)
    assert capsys.readouterr().out == ""


def test_fit_without_options_writes_a_model_and_a_figure(folder: Path) -> None:
    assert main(["fit", "ring.csv"]) == 0
    assert names(folder) == {"ring.tsp.npz", "ring.png"}


def test_segment_writes_what_is_asked_for_and_nothing_else(folder: Path) -> None:
    asked = {
        "--mask": "m.png", "--labels": "l.tif", "--contour": "c.svg", "--model": "s.tsp.npz",
        "--figure": "f.png", "--animation": "a.gif",
    }  # fmt: skip
    assert main(["segment", "coin.png", *(word for pair in asked.items() for word in pair)]) == 0
    assert names(folder) == set(asked.values())
    with Image.open("m.png") as mask:
        assert mask.size == (60, 40)
        assert set(np.unique(np.asarray(mask)).tolist()) == {0, 255}


@pytest.mark.parametrize("option", ["--mask=m.png", "--labels=l.tif", "--contour=c.geojson"])
def test_results_not_asked_for_are_not_computed(folder: Path, monkeypatch: pytest.MonkeyPatch, option: str) -> None:
    kept = {"--mask": "mask", "--labels": "labels", "--contour": "contours"}[option.split("=")[0]]

    class Lazy(types.SimpleNamespace):
        def __getattribute__(self, name: str) -> object:
            if name in {"mask", "labels", "contours"} - {kept}:
                pytest.fail(f"{name} was computed")
            return super().__getattribute__(name)

    def lazy(image: object, *, callback: object = None, **options: object) -> object:
        assert callback is None  # nothing is recorded either
        return Lazy(**vars(fake_solver.segment_image(image, **options)))

    monkeypatch.setattr(segment, "segment_image", lazy)
    assert main(["segment", "coin.png", option]) == 0


def test_options_reach_the_segmentation(folder: Path) -> None:
    write_mask("start.png", np.eye(40, 60, dtype=bool))
    words = ["--mask", "m{stem}.png", "--model-kind", "regions", "--depth", "5", "--init", "start.png"]
    words += ["--statistics", "means"]
    assert main(["segment", *words, "--seeds", "10,20", "3.5,4", "coin.png"]) == 0
    (call,) = calls()
    assert (call["model"], call["statistics"]) == ("regions", "means")
    assert call["max_depth"] == 5
    assert call["seeds"] == [(10.0, 20.0), (3.5, 4.0)]
    assert call["channel_axis"] is None
    np.testing.assert_array_equal(call["init"], np.eye(40, 60, dtype=bool))
    assert names(folder) == {"start.png", "mcoin.png"}
    assert main(["segment", "coin.png", "--box", "1,2,30,40", "--mask", "n.png"]) == 0
    assert calls()[1]["init"] == (1.0, 2.0, 30.0, 40.0)


def test_options_reach_the_fit(folder: Path) -> None:
    words = ["--depth", "6", "--tolerance", "1e-3", "--gap", "0.2", "--init", "circle", "--model", "a.npz"]
    assert main(["fit", "ring.csv", *words]) == 0
    (call,) = calls()
    assert (call["max_depth"], call["tolerance"], call["gap"], call["init"]) == (6, 1e-3, 0.2, "circle")
    assert np.shape(call["points"]) == (80, 2)


def test_colours_are_told_to_the_segmentation(folder: Path) -> None:
    Image.fromarray(np.zeros((8, 9, 3), dtype=np.uint8)).save("rgb.png")
    assert main(["segment", "rgb.png", "--mask", "m.png"]) == 0
    assert calls()[0]["channel_axis"] == 2


def test_plane_points_in_three_columns_lose_the_constant_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = np.loadtxt("ring.csv", delimiter=",")
    np.savetxt("plane.xyz", np.column_stack([points[:, 0], np.full(80, 2.0), points[:, 1]]))
    assert main(["fit", "plane.xyz", "--model", "a.npz"]) == 0
    np.testing.assert_array_equal(calls()[0]["points"], points)
    assert "same y" in capsys.readouterr().err


def test_json_has_the_promised_keys(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "ring.csv", "--json", "--model", "a.tsp.npz"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    record = json.loads(line)
    assert record["schema"] == 1
    assert record["status"] == 0
    assert record["num_coefficients"] == 361
    assert record["components"] == 1
    assert record["seconds"] >= 0
    assert record["max_residual"] >= record["rms_residual"] > 0
    assert record["outputs"] == {"model": "a.tsp.npz"}
    assert main(["segment", "coin.png", "--json", "--mask", "m.png"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert {"schema", "status", "seconds", "num_coefficients", "components"} <= record.keys()


def test_json_has_no_nan(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def vanished(points: object, **options: object) -> object:
        result = fake_solver.fit_points(points, status=2, **options)
        result.rms_residual = float("nan")
        result.max_residual = float("inf")
        return result

    monkeypatch.setattr(recon, "fit_points", vanished)
    assert main(["fit", "ring.csv", "--json", "--model", "a.npz"]) == 3
    record = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert record["rms_residual"] is None
    assert record["status"] == 3


def test_batch_goes_on_past_a_bad_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "bad.csv").write_text("1 2\nthree four\n")
    (folder / "two.csv").write_bytes((folder / "ring.csv").read_bytes())
    (folder / "out").mkdir()
    words = ["--model", "out/{stem}.tsp.npz", "--json"]
    assert main(["fit", "*.csv", *words]) == 2
    said = capsys.readouterr()
    records = [json.loads(line) for line in said.out.splitlines()]
    assert [record["input"] for record in records] == ["bad.csv", "ring.csv", "two.csv"]
    assert [record["status"] for record in records] == [2, 0, 0]
    assert records[0]["num_coefficients"] is None
    assert {path.name for path in (folder / "out").iterdir()} == {"ring.tsp.npz", "two.tsp.npz"}
    errors = [line for line in said.err.splitlines() if "error" in line]
    assert len(errors) == 2
    assert "bad.csv:2" in errors[0]
    assert "3 inputs: 2 done, 1 not accepted" in errors[1]


def test_batch_without_options_numbers_equal_names(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "ring.csv").write_bytes((folder / "ring.csv").read_bytes())
    assert main(["fit", "ring.csv", "sub/ring.csv"]) == 0
    assert names(folder) == {"sub", "ring.tsp.npz", "ring.png", "ring-1.tsp.npz", "ring-1.png"}


def test_not_converged_is_3_with_results(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recon, "fit_points", lambda p, **o: fake_solver.fit_points(p, status=1, **o))
    assert main(["fit", "ring.csv", "--model", "a.tsp.npz"]) == 3
    assert names(folder) == {"a.tsp.npz"}


class _Stream:
    """Standard input or output with bytes below."""

    def __init__(self, data: bytes = b"") -> None:
        self.buffer = io.BytesIO(data)

    def write(self, text: str) -> int:
        return self.buffer.write(text.encode())

    def flush(self) -> None:
        pass

    def isatty(self) -> bool:
        return False


@pytest.mark.parametrize("text", [True, False])
def test_from_stdin_to_stdout(folder: Path, monkeypatch: pytest.MonkeyPatch, text: bool) -> None:
    points = np.loadtxt("ring.csv", delimiter=",")
    stream = io.BytesIO()
    np.savetxt(stream, points) if text else np.save(stream, points)
    out = _Stream()
    monkeypatch.setattr(sys, "stdin", _Stream(stream.getvalue()))
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["fit", "-", "--contour", "-"]) == 0
    collection = json.loads(out.buffer.getvalue())  # nothing else was printed there
    assert collection["type"] == "FeatureCollection"
    assert names(folder) == set()


def test_image_from_stdin(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = _Stream()
    monkeypatch.setattr(sys, "stdin", _Stream((folder / "coin.png").read_bytes()))
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["segment", "-", "--mask", "-"]) == 0
    with Image.open(io.BytesIO(out.buffer.getvalue())) as mask:
        assert mask.size == (60, 40)


def test_info_of_images_and_points(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save("grey.npy", np.zeros((7, 8)))
    np.save("cloud.npy", np.ones((7, 2)))
    assert main(["info", "coin.png", "ring.csv", "grey.npy", "cloud.npy", "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["kind"] for record in records] == ["image", "points", "image", "points"]
    assert records[0]["shape"] == [40, 60]
    assert records[1]["num_points"] == 80
    assert main(["info", "ring.csv"]) == 0
    assert capsys.readouterr().out == "ring.csv: 80 points in 2D, (-0.999997, -0.999994) to (1, 0.999999)\n"


def test_info_of_a_model(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import tspline

    spline = fake_solver.FakeSpline(np.array([[0.0, 0.0], [2.0, 2.0]]), [(1, 1, 0.5)], {"made by": "a test"})
    monkeypatch.setattr(tspline, "load", lambda path: spline, raising=False)
    (folder / "a.tsp.npz").write_bytes(b"PK")
    assert main(["info", "a.tsp.npz", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["num_coefficients"], record["components"], record["num_cells"]) == (361, 1, 256)
    assert record["metadata"] == {"made by": "a test"}


def test_demo_writes_to_a_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", "shown"]) == 0
    written = {path.name for path in (folder / "shown").iterdir()}
    assert {
        "coins_mask.png",
        "coins.tsp.npz",
        "coins_figure.png",
        "coins.html",
        "ampersand.gif",
        "ampersand.svg",
    } <= written
    assert "shown/coins_figure.png" in capsys.readouterr().out
    assert main(["demo", "--out", "shown"]) == 2


def test_help_and_version_need_no_heavy_import() -> None:
    code = (
        "import sys; from cli.main import main\n"
        "for words in (['--help'], ['--version'], ['segment', '--help'], ['fit', '-h'], ['demo', '-h']):\n"
        "    assert main(words) == 0\n"
        "heavy = {'numpy', 'scipy', 'matplotlib', 'skimage', 'cv2', 'trimesh', 'PIL', 'tqdm'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in COMMANDS:
        assert name in done.stdout
    for absent in ("export", "morph", "edit"):
        assert f"\n  {absent} " not in done.stdout


def test_segment_imports_no_drawing(folder: Path) -> None:
    """A mask alone needs neither Matplotlib nor trimesh nor scikit-image on the command's side."""
    code = (
        "import sys; sys.path.insert(0, 'tests')\n"
        "import fake_solver, types\n"
        "stub = types.ModuleType('recon'); sys.modules['recon'] = stub\n"
        "import cli.segment, segment.image_file\n"
        "from cli.main import main\n"
        "segment.segment_image = fake_solver.segment_image\n"
        f"assert main(['segment', {str(folder / 'coin.png')!r}, '--mask', {str(folder / 'm.png')!r}]) == 0\n"
        "heavy = {'matplotlib', 'skimage', 'trimesh', 'tqdm', 'imageio', 'ezdxf'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
