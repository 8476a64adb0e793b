"""Random graded T-meshes from a seed."""

from __future__ import annotations

import numpy as np

from tspline.mesh import TMesh

__all__ = ["BOX", "random_mesh"]

#: A cube with dyadic corners: mapping to the unit box and back is exact for the tests' dyadic points.
BOX = {2: [[-1.5, 0.25], [2.5, 4.25]], 3: [[-1.5, 0.25, -8.0], [2.5, 4.25, -4.0]]}


def random_mesh(seed: int, dim: int, rounds: int | None = None) -> TMesh:
    """A uniform mesh of depth 1 (or 2 in 2D) with random leaves split, up to three times (3D: twice)."""
    rng = np.random.default_rng(seed)
    mesh = TMesh.uniform(BOX[dim], int(rng.integers(1, 3)) if dim == 2 else 1)
    if rounds is None:
        rounds = int(rng.integers(1, 4 if dim == 2 else 3))
    share = rng.uniform(0.05, 0.35 if dim == 2 else 0.15)
    for _ in range(rounds):
        mask = rng.random(mesh.num_cells) < share
        mask[rng.integers(mesh.num_cells)] = True
        mesh = mesh.refine(mask)
    return mesh
