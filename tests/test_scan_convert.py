"""Scan conversion of meshes against brute force, closed forms and winding numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from oracles.triangle_distance import brute_distance

from tspline import _core
from tspline.errors import InvalidArgumentError
from tspline.grid import Grid
from tspline.grid.closed_mesh import closed_mesh

Floats = NDArray[np.float64]


def dense(mesh: trimesh.Trimesh, grid: Grid, far: float) -> Floats:
    """All values."""
    vertices, faces = closed_mesh(mesh)
    blocks = _core.scan_convert(vertices, faces, grid.shape, grid.origin.tolist(), grid.spacing.tolist(), far)
    return blocks.to_dense()


def some(grid: Grid, number: int, rng: np.random.Generator) -> tuple[tuple[NDArray[np.int64], ...], Floats]:
    index = rng.integers(0, grid.shape, (number, 3))
    return tuple(index.T), grid.from_index(index)


def by_solid_angle(mesh: trimesh.Trimesh, points: Floats) -> Floats:
    """Winding number by solid angles: van Oosterom and Strackee (1983)."""
    numbers = []
    for p in points:
        a, b, c = (mesh.vertices[mesh.faces[:, k]] - p for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        over = np.einsum("mq,mq->m", a, np.cross(b, c))
        below = la * lb * lc + np.sum(a * b, 1) * lc + np.sum(b * c, 1) * la + np.sum(c * a, 1) * lb
        numbers.append(np.arctan2(over, below).sum() / (2 * np.pi))
    return np.array(numbers)


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.icosphere(subdivisions=2),
        trimesh.creation.torus(1.0, 0.35, 24, 12),
        trimesh.creation.box((1.3, 0.9, 1.1)),
        trimesh.creation.capsule(height=1.5, radius=0.3, count=[9, 9]),
        trimesh.util.concatenate(
            [trimesh.creation.box((1.0, 1, 1)), trimesh.creation.icosphere(subdivisions=1, radius=0.7)]
        ),
    ],
    ids=["ball", "torus", "box", "capsule", "cut"],
)
def test_distances_and_signs(mesh: trimesh.Trimesh, rng: np.random.Generator) -> None:
    grid = Grid.around(mesh.bounds, [0.06, 0.05, 0.08], margin=0.2)
    values = dense(mesh, grid, 0.3)
    index, points = some(grid, 400, rng)
    expected = np.minimum(brute_distance(points, mesh.vertices, mesh.faces), 0.3)
    inside = by_solid_angle(mesh, points) > 0.5
    # Products of coordinates of size 2, and a square root: some units in the last place of the distance's square.
    np.testing.assert_allclose(values[index], np.where(inside, -expected, expected), rtol=0, atol=2e-15)


def test_no_far_sign_leaks() -> None:
    """Neighbours of different sign are never both far."""
    mesh = trimesh.creation.torus(1.0, 0.31, 64, 32)
    values = dense(mesh, Grid.around(mesh.bounds, 0.03, margin=0.3), 0.06)
    for axis in range(3):
        a, b = np.moveaxis(values, axis, 0)[:-1], np.moveaxis(values, axis, 0)[1:]
        assert np.all((a < 0) == (b < 0)) or np.abs(a - b)[(a < 0) != (b < 0)].max() <= 0.03 + 1e-12


def test_spheres_converge_to_the_analytic_one() -> None:
    """The field of an inscribed polyhedron is above that of its ball by less than the sagitta."""
    for subdivisions in (3, 4):
        mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.8)
        grid = Grid.around(mesh.bounds, 0.06, margin=0.2)
        values = dense(mesh, grid, 0.18)
        exact = np.linalg.norm(grid.nodes(), axis=-1) - 0.8
        near = np.abs(exact) < 0.17
        sagitta = 0.8 - np.linalg.norm(mesh.triangles_center, axis=1).min()
        error = (values - exact)[near]
        assert error.min() > -1e-14
        assert error.max() < 1.01 * sagitta


def test_a_mesh_does_not_depend_on_the_order_or_the_side_of_its_triangles(rng: np.random.Generator) -> None:
    mesh = trimesh.creation.torus(1.0, 0.4, 20, 10)
    grid = Grid.around(mesh.bounds, 0.1, margin=0.2)
    turned = trimesh.Trimesh(mesh.vertices, rng.permutation(mesh.faces)[:, ::-1], process=False)
    soup = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)
    expected = dense(mesh, grid, 0.3)
    np.testing.assert_allclose(dense(turned, grid, 0.3), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(dense(soup, grid, 0.3), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", ["kitten", "torus", "featuretype", "stelldodeca", "plateholes"])
def test_real_meshes(name: str, data_folder: Path, rng: np.random.Generator) -> None:
    mesh = trimesh.load(data_folder / "meshes" / f"{name}.ply", process=False)
    h = float(mesh.extents.max()) / 60
    grid = Grid.around(mesh.bounds, h, margin=4 * h)
    values = dense(mesh, grid, 3 * h)
    index, points = some(grid, 60, rng)
    expected = np.minimum(brute_distance(points, mesh.vertices, mesh.faces), 3 * h)
    inside = by_solid_angle(mesh, points) > 0.5
    np.testing.assert_allclose(values[index] / h, np.where(inside, -expected, expected) / h, rtol=0, atol=1e-11)


def test_what_is_no_solid_is_refused() -> None:
    box = trimesh.creation.box()
    v, f = np.array(box.vertices), np.array(box.faces)
    bad = v.copy()
    bad[2, 0] = np.nan
    flat = v * [1.0, 1.0, 0.0]
    flipped = f.copy()
    flipped[0] = flipped[0, ::-1]
    for mesh, found in [
        ((v, f[1:]), "3 open edges"),
        ((v, f[:0]), "no triangles"),
        ((bad, f), "1 that are not finite"),
        ((v, np.where(f == 7, 8, f)), "numbers of 8 vertices"),
        ((v, f - 1), "-1 .. 6"),
        ((flat, f), "no volume"),
        ((v, flipped), "3 edges whose triangles disagree"),
        ((v, f.astype(float)), "float64"),
        ((v[:, :2], f), r"\(8, 2\)"),
        ((v, np.zeros((4, 3), dtype=int)), "without area"),
        (v, "ndarray"),
    ]:
        with pytest.raises(InvalidArgumentError, match=found):
            closed_mesh(mesh)
