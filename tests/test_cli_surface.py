"""``tspline fit`` on points in space, and ``tspline info`` on what comes of it; the solver is a stand-in."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path

import fake_solver
import numpy as np
import pytest
import trimesh
from PIL import Image

import recon
from cli.main import main
from tspline import TSpline

NUM = 300
RADIUS = 2.0
CENTER = np.array([5.0, -1.0, 3.0])


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """A current folder with points of a sphere, and what the stand-ins were asked for."""
    monkeypatch.chdir(tmp_path)
    arrows = np.random.default_rng(4).normal(size=(NUM // 2, 3))
    arrows /= np.linalg.norm(arrows, axis=1, keepdims=True)
    arrows = np.vstack([arrows, -arrows])
    np.savetxt("ball.xyz", CENTER + RADIUS * arrows)
    np.savetxt("oriented.xyz", np.hstack([CENTER + RADIUS * arrows, arrows]))
    angle = np.linspace(0, 6.2, 80)
    np.savetxt("ring.csv", np.column_stack([np.cos(angle), np.sin(angle)]), delimiter=",")
    np.savetxt("flat.xyz", np.column_stack([np.cos(angle), np.full(80, 2.0), np.sin(angle)]))
    noted: list[dict[str, object]] = []

    def fit_points(points: object, **options: object) -> object:
        noted.append({"points": points, **options})
        return fake_solver.fit_points(points, **options)

    def to_mesh(self: TSpline, tolerance: float | None = None) -> object:
        noted.append({"to_mesh": tolerance})
        return fake_solver.sphere_mesh(self)

    writer = types.ModuleType("tspline.export.mesh_file")

    def save_mesh(mesh: trimesh.Trimesh, path: Path, *, ending: str | None = None) -> None:
        mesh.export(str(path), file_type=(ending or Path(path).suffix)[1:])

    writer.save_mesh = save_mesh  # type: ignore[attr-defined]
    monkeypatch.setattr(recon, "fit_points", fit_points)
    monkeypatch.setattr(TSpline, "to_mesh", to_mesh, raising=False)
    monkeypatch.setitem(sys.modules, "tspline.export.mesh_file", writer)
    return noted


def names() -> set[str]:
    inputs = {"ball.xyz", "oriented.xyz", "ring.csv", "flat.xyz"}
    return {path.name for path in Path().iterdir()} - inputs


def refused(capsys: pytest.CaptureFixture[str], *words: str, status: int = 2) -> str:
    """Run the command, which must end with `status`, one line on standard error, and no new file."""
    before = names()
    assert main(list(words)) == status
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert names() == before
    return line


@pytest.mark.parametrize("ending", [".ply", ".stl", ".obj", ".glb"])
def test_a_mesh_is_written(ending: str, calls: list[dict[str, object]]) -> None:
    assert main(["fit", "ball.xyz", "--mesh", f"out{ending}"]) == 0
    assert names() == {f"out{ending}"}
    mesh = trimesh.load(f"out{ending}", force="mesh")
    assert mesh.is_watertight
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - CENTER, axis=1), RADIUS, rtol=1e-6)
    assert np.shape(calls[0]["points"]) == (NUM, 3)
    assert calls[0]["normals"] is None
    assert calls[0]["callback"] is None


def test_without_options_a_model_and_a_figure(
    calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", "ball.xyz"]) == 0
    assert names() == {"ball.tsp.npz", "ball.png"}
    assert "ball.xyz: 1 component, genus 0, 6,859 coefficients" in capsys.readouterr().out
    with Image.open("ball.png") as figure:
        assert figure.width > 1000


def test_only_what_needs_a_mesh_makes_one(calls: list[dict[str, object]]) -> None:
    assert main(["fit", "ball.xyz", "--model", "a.tsp.npz"]) == 0
    assert not any("to_mesh" in call for call in calls)
    assert main(["fit", "ball.xyz", "--mesh", "a.ply", "--figure", "a.png"]) == 0
    assert sum("to_mesh" in call for call in calls) == 1


def test_json_of_a_surface(calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "ball.xyz", "--json", "--mesh", "a.ply"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["status"], record["dim"], record["components"], record["genus"]) == (0, 3, 1, 0)
    assert record["num_coefficients"] == 19**3
    assert record["seconds"] >= 0
    assert record["max_residual"] >= record["rms_residual"] >= 0
    # the stand-in's 1,280 triangles lie inside the sphere
    assert record["area"] == pytest.approx(4 * np.pi * RADIUS**2, rel=0.01)
    assert record["volume"] == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)
    assert record["outputs"] == {"mesh": "a.ply"}
    assert main(["fit", "ball.xyz", "--json", "--model", "a.npz"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["genus"], record["area"], record["volume"]) == (0, None, None)


def test_the_mesh_tells_the_genus_where_the_fit_does_not(
    calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit_points(points: object, **options: object) -> object:
        result = fake_solver.fit_points(points, **options)
        del result.genus
        return result

    monkeypatch.setattr(recon, "fit_points", fit_points)
    monkeypatch.setattr(TSpline, "to_mesh", lambda self: trimesh.creation.torus(1.0, 0.3))
    assert main(["fit", "ball.xyz", "--json", "--mesh", "a.ply"]) == 0
    assert json.loads(capsys.readouterr().out)["genus"] == 1


def test_options_and_normals_reach_the_fit(calls: list[dict[str, object]]) -> None:
    words = ["--depth", "6", "--tolerance", "1e-3", "--gap", "0.2", "--init", "sphere", "--model", "a.npz"]
    assert main(["fit", "oriented.xyz", *words]) == 0
    (call,) = calls
    assert (call["max_depth"], call["tolerance"], call["gap"], call["init"]) == (6, 1e-3, 0.2, "sphere")
    np.testing.assert_allclose(np.linalg.norm(np.asarray(call["normals"]), axis=1), 1.0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("ball.xyz --contour a.svg", "ball.xyz: --contour needs points in 2D, found points in 3D; accepted is --mesh"),
        ("ball.xyz --animation a.gif", "--animation needs points in 2D, found points in 3D; accepted is --figure"),
        ("ring.csv --mesh a.ply", "ring.csv: --mesh needs points in 3D, found points in 2D; accepted is --contour"),
        ("flat.xyz --mesh a.ply", "found points that all have the same y"),
        ("ball.xyz --mesh a.vtk", "accepted is .ply .stl .obj .glb .3mf"),
        ("ball.xyz --mesh none/a.ply", "there is no folder"),
        ("ball.xyz --mesh ball.xyz.ply --model ball.xyz.ply", "the ending '.ply'"),
    ],
)
def test_what_does_not_fit_the_points_is_refused_before_the_fit(
    words: str, told: str, calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert told in refused(capsys, "fit", *words.split())
    assert calls == []


def test_batch_of_both_kinds(calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").mkdir()
    assert main(["fit", "ball.xyz", "ring.csv", "oriented.xyz", "--mesh", "out/{stem}.stl", "--json"]) == 2
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["status"] for record in records] == [0, 2, 0]
    assert {path.name for path in Path("out").iterdir()} == {"ball.stl", "oriented.stl"}
    assert main(["fit", "ball.xyz", "ring.csv", "--json", "--model", "out/{stem}.tsp.npz"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["dim"] for record in records] == [3, 2]
    assert records[0].keys() == records[1].keys()


def test_force_and_quiet(calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    Path("a.ply").write_bytes(b"mine")
    assert "a.ply: exists" in refused(capsys, "fit", "ball.xyz", "--mesh", "a.ply")
    assert Path("a.ply").read_bytes() == b"mine"
    assert main(["fit", "ball.xyz", "--mesh", "a.ply", "--force", "--quiet"]) == 0
    assert Path("a.ply").read_bytes().startswith(b"ply")
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "")


def test_interrupt_while_the_mesh_is_written(
    calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(mesh: object, path: Path, **options: object) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["tspline.export.mesh_file"], "save_mesh", interrupted)
    assert "interrupted" in refused(capsys, "fit", "ball.xyz", "--mesh", "a.ply", status=130)


def test_a_fit_that_vanished_has_no_mesh(
    calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def vanished(points: object, **options: object) -> object:
        result = fake_solver.fit_points(points, status=2, **options)
        result.num_components = 0
        return result

    monkeypatch.setattr(recon, "fit_points", vanished)
    assert "a.ply: there is no surface to write" in refused(capsys, "fit", "ball.xyz", "--mesh", "a.ply", status=1)
    assert main(["fit", "ball.xyz"]) == 3
    assert names() == {"ball.tsp.npz", "ball.png"}


def test_info_of_models_and_points_in_space(calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "ball.xyz", "--model", "a.tsp.npz", "--quiet"]) == 0
    assert main(["info", "a.tsp.npz", "ball.xyz", "oriented.xyz", "--json"]) == 0
    model, plain, oriented = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (model["kind"], model["dim"], model["depth"], model["num_coefficients"]) == ("model", 3, 4, 19**3)
    assert np.shape(model["bounds"]) == (2, 3)
    assert (plain["kind"], plain["dim"], plain["normals"]) == ("points", 3, False)
    assert oriented["normals"] is True
    assert main(["info", "a.tsp.npz"]) == 0
    said = capsys.readouterr().out
    assert "3D T-spline level set" in said
    assert "depth 4" in said


@pytest.mark.parametrize("ending", [".ply", ".stl", ".obj", ".glb"])
def test_info_of_meshes(ending: str, calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.torus(1.0, 0.3).export(f"a{ending}")
    assert main(["info", f"a{ending}", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["kind"], record["components"], record["genus"], record["closed"]) == ("mesh", 1, 1, True)
    assert record["volume"] == pytest.approx(2 * np.pi**2 * 0.09, rel=0.05)


def test_info_of_damaged_meshes(calls: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> None:
    Path("a.stl").write_bytes(b"solid nothing")
    Path("b.glb").write_bytes(b"glTF" + bytes(20))
    assert "a.stl: " in refused(capsys, "info", "a.stl")
    assert "b.glb: " in refused(capsys, "info", "b.glb")
