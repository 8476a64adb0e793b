"""What a file of points holds: places, and normals where it has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Scan"]

FloatArray = npt.NDArray[np.float64]

_UNIT_LENGTHS = (0.95, 1.05)
"""Lengths of what is taken for unit normals: two decimals a component keep within this."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Points with their normals, as a file gives them; nothing is merged or scaled.

    Attributes
    ----------
    points : (n, d) float64, d = 2 or 3
        Columns x, y[, z], in the file's unit.
    normals : (n, d) float64 or None
        None of them zero, of any length; the file says which side they point to.
    notes : tuple of str
        What the file holds but was not taken, for the user.
    """

    points: FloatArray
    normals: FloatArray | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, points: FloatArray, normals: FloatArray | None) -> Scan:
        """Points with what the file calls normals; they are left out where one cannot be used."""
        if normals is None:
            return cls(points)
        bad = ~np.isfinite(normals).all(axis=1) | ~normals.any(axis=1)
        if bad.any():
            return cls(points, None, (f"the normals are not used: {int(bad.sum())} of them are zero or not finite",))
        return cls(points, normals)

    @classmethod
    def from_table(cls, table: FloatArray) -> Scan:
        """Rows of two or three coordinates, or of six numbers: x y z and a normal where all are of length 1.

        Colours stand in the same three columns, and only their length tells them from normals.
        """
        if table.shape[1] != 6:
            return cls(np.ascontiguousarray(table))
        points, rest = np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:])
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", rest, rest))
        if bool(((length > _UNIT_LENGTHS[0]) & (length < _UNIT_LENGTHS[1])).all()):
            return cls(points, rest)
        return cls(points, None, ("columns 4 to 6 are not used: they are no normals of length 1",))
