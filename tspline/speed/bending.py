"""Bending of a zero set that is known by scattered samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array
from scipy.spatial import cKDTree

from tspline.speed.samples import Floats, LevelSetSamples

__all__ = ["Bending"]

#: Samples that a second derivative is taken from, itself included: some three times the unknowns of the quadratic, as
#: samples of a grid come in clusters.
NEIGHBOURS = {2: 9, 3: 20}
#: Second difference over the width of a fit that stands for what a sample is off its fit: a zigzag from sample to
#: sample bends no quadratic, but must cost more than all waves that do.
ZIGZAG = 4.0


@dataclass(frozen=True)
class Bending:
    """Second derivatives along a zero set, and what they leave out.

    At each sample a quadratic function of the tangential coordinates is fitted to the values around it, nearer ones
    counting more, those on the other side of a thin part not at all. So derivatives are exact for quadratics, however
    uneven the samples.

    Attributes
    ----------
    laplacian : csr_array, shape (m, m)
        Laplacian along the zero set of values at the samples.
    zigzag : csr_array, shape (m, m)
        Difference of each value from the fit around it, as a second difference.
    """

    laplacian: csr_array
    zigzag: csr_array

    @classmethod
    def of(cls, samples: LevelSetSamples, tree: cKDTree) -> Bending:
        """Operators on the samples; `tree` holds their points."""
        points, normals = samples.points, samples.normals
        m, d = points.shape
        count = min(NEIGHBOURS[d], m)
        distance, near = tree.query(points, k=np.arange(1, count + 1), workers=-1)
        width = 0.5 * float(np.median(distance[:, -1]))
        if width <= 0:
            return cls(csr_array((m, m)), csr_array((m, m)))
        facing = (normals[near] @ normals[:, :, None])[..., 0]
        weights = np.exp(-0.5 * (distance / width) ** 2) * np.maximum(facing, 0.0)
        along = (points[near] - points[:, None]) @ np.moveaxis(_tangents(normals), 1, 2) / width
        columns = [np.ones((m, count)), *np.moveaxis(along, -1, 0), *np.moveaxis(0.5 * along**2, -1, 0)]
        if d == 3:
            columns.append(along[..., 0] * along[..., 1])
        basis = np.stack(columns, axis=-1)
        weighted = basis * weights[..., None]
        normal = np.moveaxis(basis, 1, 2) @ weighted
        # Too few samples on this side for a quadratic: the least one that fits.
        normal += 1e-6 * np.eye(basis.shape[-1])
        asked = np.zeros((basis.shape[-1], 2))
        asked[d : 2 * d - 1, 0] = 1.0 / width**2
        asked[0, 1] = 1.0
        rows = weighted @ np.linalg.solve(normal, np.broadcast_to(asked, (m, *asked.shape)))
        places = near.ravel().astype(np.int64), np.arange(0, m * count + 1, count)
        second, fitted = (csr_array((rows[..., k].ravel(), *places), shape=(m, m)) for k in range(2))
        return cls(second, ((ZIGZAG / width**2) * (eye_array(m) - fitted)).tocsr())

    def normal_part(self, operator: csr_array, samples: LevelSetSamples) -> Floats:
        """An operator on the samples' places, along their normals, shape (m,): the Laplacian's is -kappa."""
        part: Floats = np.einsum("md,md->m", operator @ samples.points, samples.normals)
        return part


def _tangents(normals: Floats) -> NDArray[np.float64]:
    """Unit vectors across unit normals (m, d), shape (m, d - 1, d)."""
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
    # Across the axis that the normal has least of.
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)
