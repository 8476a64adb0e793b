"""Meshes in the world of the file: at the affine's places, outward, with normals that stand on the faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from segment.picture import Geometry
from segment.picture.world_mesh import world_mesh
from tspline.export import save_mesh


@pytest.mark.parametrize("sheared", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_random_affines(seed: int, sheared: bool) -> None:
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag(rng.choice([-1.0, 1.0], 3))
    affine = np.eye(4)
    affine[:3, :3] = directions * rng.uniform(0.3, 4.0, 3)
    affine[:3, 3] = rng.uniform(-100.0, 100.0, 3)
    if sheared:  # slices of a tilted gantry are shifted along the rows
        affine[:3, 2] += 0.4 * affine[:3, 1]
    geometry = Geometry.of_affine(affine, "RAS", "mm")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=4.0)
    index = ball.vertices + 9.0
    body = trimesh.Trimesh(index * geometry.spacing, ball.faces, process=False)
    moved = world_mesh(body, geometry)
    np.testing.assert_allclose(moved.vertices, geometry.to_physical(index), atol=1e-9)
    assert moved.is_watertight
    assert moved.volume == pytest.approx(ball.volume * abs(np.linalg.det(affine)), rel=1e-9)
    # normals of an ellipsoid |index - 9| = 4 are the covectors of its gradient
    gradient = ball.vertices @ np.linalg.inv(geometry.steps)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", moved.vertex_normals, gradient).min() > 0.99  # those of the facetted ball are means


@pytest.mark.parametrize(("world", "told"), [("RAS", b"SPACE=RAS"), (None, b"")])
@pytest.mark.parametrize("ending", [".ply", ".obj", ".stl"])
def test_meshes_tell_their_world(tmp_path: Path, ending: str, world: str | None, told: bytes) -> None:
    path = tmp_path / f"a{ending}"
    save_mesh(trimesh.creation.icosphere(subdivisions=1), path, world=world)
    head = path.read_bytes()[:400]
    assert told in head
    assert world is not None or b"SPACE" not in head
    assert trimesh.load(path).is_watertight
