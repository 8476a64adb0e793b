"""Where the samples of a picture lie in the world."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tspline.errors import InvalidArgumentError, require

__all__ = ["ARRAY", "IMAGE", "Geometry"]

FloatArray = npt.NDArray[np.float64]

IMAGE = "image"
"""World of files that know no other: x = column, y = row (downward), z = plane."""
ARRAY = "array"
"""World of NumPy's own files with volumes: the array's axes in their order."""

_SAME_PLACE = 1e-3
"""Two grids are the same when no sample is further off than this share of its spacing; headers round to about 1e-6."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Places of samples: origin + steps @ index.

    Attributes
    ----------
    origin : (3,) float64
        Centre of the sample with index 0, in the world.
    steps : (3, 3) float64
        Column a leads from a sample to the next one along array axis a (plane, row, column).
    world : str
        What the three coordinates are: three letters where x, y and z increase to (R or L, A or P, S or I), such as
        "RAS" (NIfTI) or "LPS" (DICOM, most NRRD files); `IMAGE`; `ARRAY`; or a name that a file gave.
    unit : str
        Of the coordinates, such as "mm"; empty where nobody told it.
    is_physical : bool
        Whether file or user told a spacing; else it is 1.
    plane_axis : int, optional
        The array axis of length 1 that was left out; None in volumes.
    """

    origin: FloatArray
    steps: FloatArray
    world: str
    unit: str = ""
    is_physical: bool = False
    plane_axis: int | None = None

    @classmethod
    def of_image(cls, spacing: Sequence[float] | None = None, unit: str = "", *, planar: bool) -> Geometry:
        """Grid of an image (row, column) or of a stack (plane, row, column), with its `spacing` along these axes."""
        sides = _full(spacing, planar)
        steps = np.zeros((3, 3))
        steps[[2, 1, 0], [0, 1, 2]] = sides
        return cls(np.zeros(3), steps, IMAGE, unit, spacing is not None, 0 if planar else None)

    @classmethod
    def of_array(cls, spacing: Sequence[float] | None = None) -> Geometry:
        """Grid of a volume (plane, row, column) that has no world but its own axes."""
        return cls(np.zeros(3), np.diag(_full(spacing, False)), ARRAY, "", spacing is not None)

    @classmethod
    def of_affine(cls, affine: FloatArray, world: str, unit: str) -> Geometry:
        """From a matrix (4, 4) or (3, 4) that takes (column, row, plane, 1) to the world."""
        return cls(affine[:3, 3].copy(), affine[:3, 2::-1].copy(), world, unit, True)

    @property
    def affine(self) -> FloatArray:
        """(4, 4): takes (column, row, plane, 1) to the world, as NIfTI and ITK have it."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.steps[:, ::-1]
        matrix[:3, 3] = self.origin
        return matrix

    @property
    def axes(self) -> list[int]:
        """The array axes that the picture has, of plane, row and column."""
        return [axis for axis in range(3) if axis != self.plane_axis]

    @property
    def spacing(self) -> tuple[float, ...]:
        """Distance of neighbouring samples along each axis of the picture."""
        return tuple(float(side) for side in np.linalg.norm(self.steps[:, self.axes], axis=0))

    @property
    def is_anatomical(self) -> bool:
        """Whether the world's axes are those of a body."""
        return _letters(self.world) is not None

    def to_physical(self, points: npt.ArrayLike) -> FloatArray:
        """Places of index coordinates.

        Parameters
        ----------
        points : (n, d) array
            Index coordinates in array-axis order, integers are the samples' centres; d is 3, or 2 for planar pictures.

        Returns
        -------
        (n, 3) float64
            Coordinates in the world. Planar pictures in the world `IMAGE`: (n, 2), x and y.
        """
        index = np.asarray(points, dtype=np.float64)
        count = len(self.axes)
        require(index.ndim == 2 and index.shape[1] == count, "points", f"shape {index.shape}", f"(n, {count})")
        places: FloatArray = index @ self.steps[:, self.axes].T + self.origin
        return places[:, :2] if self.plane_axis is not None and self.world == IMAGE else places

    def to_index(self, places: npt.ArrayLike) -> FloatArray:
        """Index coordinates (n, 3) of (plane, row, column) of places (n, 3) in the world."""
        offsets = (np.asarray(places, dtype=np.float64) - self.origin).T
        return np.asarray(np.linalg.solve(self.steps, offsets).T, dtype=np.float64)

    def in_world(self, world: str) -> Geometry:
        """The same places in another body world; worlds without a body are taken for LPS, as ITK does.

        Parameters
        ----------
        world : str
            Three letters, such as "RAS".
        """
        source = self
        if self.world == ARRAY:
            # x runs along the columns in every other program
            source = replace(self, origin=self.origin[::-1].copy(), steps=self.steps[::-1].copy())
        here, there = _letters(source.world) or "LPS", _letters(world)
        if there is None:
            raise InvalidArgumentError("world", repr(world), "three letters, such as 'RAS'")
        signs = np.array([1.0 if a == b else -1.0 for a, b in zip(here, there, strict=True)])
        return replace(source, origin=source.origin * signs, steps=source.steps * signs[:, None], world=world)

    def with_spacing(self, spacing: Sequence[float]) -> Geometry:
        """The same directions and origin, with other distances along the picture's axes."""
        require(len(spacing) == len(self.axes), "spacing", str(tuple(spacing)), f"{len(self.axes)} lengths")
        steps = self.steps.copy()
        steps[:, self.axes] *= np.asarray(spacing, dtype=np.float64) / np.asarray(self.spacing)
        return replace(self, steps=steps, is_physical=True)

    def restored(self, array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """An array of the picture's spatial shape as (plane, row, column), the axis that was left out in its place."""
        return array if self.plane_axis is None else np.expand_dims(array, self.plane_axis)

    def reordering(
        self, shape: Sequence[int], other: Geometry, other_shape: Sequence[int]
    ) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
        """How the array of another file with the same grid has to be turned, None if its grid is another one.

        Parameters
        ----------
        shape, other_shape : three int
            Samples (plane, row, column) of both.
        other : Geometry
            In any body world.

        Returns
        -------
        (axes, flipped)
            ``np.flip(array.transpose(axes), flipped)`` has its samples where this geometry has them.
        """
        theirs = other.in_world("LPS")
        mine = self.in_world("LPS")
        corners = np.array(list(itertools.product(*((0.0, extent - 1.0) for extent in shape))))
        wanted = theirs.to_index(mine._places(corners))
        for axes in itertools.permutations(range(3)):
            if tuple(other_shape[axis] for axis in axes) != tuple(shape):
                continue
            for flips in itertools.product((False, True), repeat=3):
                index = np.empty_like(corners)
                for axis, source in enumerate(axes):
                    last = shape[axis] - 1.0
                    index[:, source] = last - corners[:, axis] if flips[axis] else corners[:, axis]
                if bool(np.all(np.abs(index - wanted) <= _SAME_PLACE * np.maximum(1.0, np.max(shape)))):
                    return axes, tuple(axis for axis in range(3) if flips[axis])
        return None

    def _places(self, points: FloatArray) -> FloatArray:
        """Places (n, 3) of index coordinates (n, 3) of (plane, row, column), of planar pictures too."""
        places: FloatArray = points @ self.steps.T + self.origin
        return places


def _letters(world: str) -> str | None:
    """The world's three letters, None where it has none."""
    pairs = ("RL", "AP", "SI")
    known = len(world) == 3 and all(letter in pair for letter, pair in zip(world, pairs, strict=True))
    return world if known else None


def _full(spacing: Sequence[float] | None, planar: bool) -> list[float]:
    sides = [1.0] * (2 if planar else 3) if spacing is None else [float(side) for side in spacing]
    require(len(sides) == (2 if planar else 3), "spacing", str(tuple(sides)), f"{2 if planar else 3} lengths")
    require(all(np.isfinite(side) and side > 0 for side in sides), "spacing", str(tuple(sides)), "positive lengths")
    return [1.0, *sides] if planar else sides
