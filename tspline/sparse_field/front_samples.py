"""Samples of the sparse field's zero set, computed when a speed asks for them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tspline import _core
from tspline.grid import Grid
from tspline.sparse_field.grid_state import GridState
from tspline.speed import LevelSetSamples

__all__ = ["FrontSamples"]

Floats = NDArray[np.float64]


class FrontSamples(LevelSetSamples):
    """One sample an active node, where its normal meets the zero set; see `LevelSetSamples`.

    A constant speed needs none of the arrays: each is made when it is first asked for, during the step that the samples
    were made for.
    """

    def __init__(self, core: _core.SparseField, grid: Grid, state: GridState, *, staged: bool, time: float) -> None:
        # Frozen, as its parent is: attributes go round the lock.
        self.__dict__.update(_core=core, _grid=grid, _staged=staged, state=state, time=time, _count=core.num_active)

    def close(self) -> None:
        """The zero set is about to move: what was not asked for is no longer to be had."""
        self.__dict__["_core"] = None

    @property
    def _open(self) -> _core.SparseField:
        core: _core.SparseField | None = self.__dict__["_core"]
        if core is None:
            raise RuntimeError("these samples are of an earlier step: ask for what you need while the speed is called")
        return core

    @cached_property
    def _arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        points, normals, norm, weights = self._open.samples(self.__dict__["_staged"])
        return points + self.__dict__["_grid"].origin, normals, norm, weights

    @property
    def points(self) -> Floats:
        """Places on the zero set, shape (m, d)."""
        return self._arrays[0]

    @property
    def normals(self) -> Floats:
        """Unit normals, outward, shape (m, d)."""
        return self._arrays[1]

    @property
    def gradient_norm(self) -> Floats:
        """|grad f|, shape (m,)."""
        return self._arrays[2]

    @property
    def weights(self) -> Floats:
        """Shares of length or area, shape (m,): each node's cell spread over the layer, right in the mean."""
        return self._arrays[3]

    @cached_property
    def curvatures(self) -> Floats:
        """kappa = div n, shape (m,), by central differences."""
        curvatures: Floats = self._open.curvatures(self.__dict__["_staged"])
        return curvatures

    @cached_property
    def principal_curvatures(self) -> Floats:
        """k1 >= k2, shape (m, 2), by differences of normals; in the plane kappa alone, shape (m, 1)."""
        both: Floats = self._open.principal_curvatures(self.__dict__["_staged"])
        return both if self.__dict__["_grid"].dim == 3 else both[:, :1]

    def __len__(self) -> int:
        count: int = self.__dict__["_count"]
        return count
