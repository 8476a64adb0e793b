"""Meshes in PLY, STL, OBJ, GLB and 3MF, read back by a program that did not write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tspline.errors import InvalidArgumentError
from tspline.export import MESH_ENDINGS, save_mesh

#: Far from the origin, as surveys are: single precision would move vertices there by centimetres.
FAR = np.array([4.5e5, 5.2e6, 120.0])


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=2, radius=3.0)


def read(path: Path) -> Any:
    return trimesh.load(path, force="mesh")


@pytest.mark.parametrize("ending", MESH_ENDINGS)
def test_what_is_written_is_read(tmp_path: Path, ball: trimesh.Trimesh, ending: str) -> None:
    path = tmp_path / f"ball{ending}"
    save_mesh(ball, path)
    found = read(path)
    assert found.is_watertight
    assert found.is_winding_consistent
    assert len(found.faces) == len(ball.faces)
    assert found.volume == pytest.approx(ball.volume, rel=1e-6)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("ending", "accuracy"), [(".ply", 1e-9), (".3mf", 1e-9), (".obj", 0.02), (".glb", 1e-5)])
def test_places_far_from_the_origin(tmp_path: Path, ball: trimesh.Trimesh, ending: str, accuracy: float) -> None:
    path = tmp_path / f"ball{ending}"
    moved = trimesh.Trimesh(ball.vertices + FAR, ball.faces, process=False)
    save_mesh(moved, path)
    found = read(path)
    np.testing.assert_allclose(found.bounds, moved.bounds, rtol=0, atol=accuracy)


@pytest.mark.parametrize("ending", [".ply", ".obj", ".glb"])
def test_normals_are_kept(tmp_path: Path, ball: trimesh.Trimesh, ending: str) -> None:
    path = tmp_path / f"ball{ending}"
    save_mesh(ball, path)
    found: Any = trimesh.load(path, force="mesh", process=False)
    outward = found.vertices / np.linalg.norm(found.vertices, axis=1, keepdims=True)
    np.testing.assert_allclose(found.vertex_normals, outward, atol=0.01)


def test_units(tmp_path: Path, ball: trimesh.Trimesh) -> None:
    for ending in MESH_ENDINGS:
        save_mesh(ball, tmp_path / f"ball{ending}", units="in")
    assert b"comment units: inch" in (tmp_path / "ball.ply").read_bytes()
    assert "# units: inch" in (tmp_path / "ball.obj").read_text()
    assert read(tmp_path / "ball.3mf").units in ("inch", "inches")
    np.testing.assert_allclose(read(tmp_path / "ball.glb").extents, ball.extents * 0.0254, rtol=1e-6)
    np.testing.assert_allclose(read(tmp_path / "ball.stl").extents, ball.extents, rtol=1e-6)


def test_files_are_equal_for_equal_meshes(tmp_path: Path, ball: trimesh.Trimesh) -> None:
    for ending in MESH_ENDINGS:
        for name in "ab":
            save_mesh(ball, tmp_path / f"{name}{ending}")
        assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()


def test_what_cannot_be_written_is_refused(tmp_path: Path, ball: trimesh.Trimesh) -> None:
    with pytest.raises(InvalidArgumentError, match=r"\.ply, \.stl, \.obj, \.glb, \.3mf"):
        save_mesh(ball, tmp_path / "ball.vtk")
    with pytest.raises(InvalidArgumentError, match="micron, millimeter"):
        save_mesh(ball, tmp_path / "ball.ply", units="parsec")
    with pytest.raises(InvalidArgumentError, match="no faces"):
        save_mesh(trimesh.Trimesh(), tmp_path / "ball.ply")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "ball.ply").write_text("old")
    with pytest.raises(FileExistsError):
        save_mesh(ball, tmp_path / "ball.ply")
    assert (tmp_path / "ball.ply").read_text() == "old"
    save_mesh(ball, tmp_path / "ball.ply", force=True)
    assert read(tmp_path / "ball.ply").is_watertight
