"""What ``tspline fit`` writes and tells of a surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cli.outputs import OutputKind, Target

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = ["MESH", "SurfaceResult"]

MESH = OutputKind("mesh", (".ply", ".stl", ".obj", ".glb", ".3mf"))

FEW_TRIANGLES = 10_000
"""A figure of fewer has edges in its outlines that can be seen."""


@dataclass(frozen=True)
class SurfaceResult:
    """A fit to points in space, with its mesh where one was needed."""

    fit: Any
    """`recon.FitResult` of points (n, 3)."""
    mesh: Any
    """trimesh.Trimesh; None where no output needs one, or where there is no surface."""

    @classmethod
    def of(cls, fit: Any, targets: Mapping[str, Target]) -> SurfaceResult:
        """Make the mesh if one of the targets needs it."""
        needed = fit.num_components > 0 and ("mesh" in targets or "figure" in targets)
        mesh = fit.field.to_mesh() if needed else None
        return cls(fit, mesh if mesh is not None and len(mesh.faces) else None)

    @property
    def genus(self) -> int | None:
        """Handles of all parts together, as the fit or else the mesh tells; None where neither does."""
        told = getattr(self.fit, "genus", None)
        if told is not None:
            return int(told)
        # Euler: V - E + F = 2 (closed surfaces - handles); a hollow part has two surfaces
        return None if self.mesh is None else int(self.mesh.body_count) - int(self.mesh.euler_number) // 2

    def write(self, targets: Mapping[str, Target], points: npt.NDArray[np.float64], title: str) -> None:
        """Write the mesh and the figure where asked for.

        Raises
        ------
        VanishedError
            A mesh is asked for and there is no surface.
        """
        if "mesh" in targets:
            self._write_mesh(targets["mesh"])
        if "figure" in targets:
            from tspline.figure.evolution import save_figure
            from tspline.figure.surface import surface_figure

            figure = surface_figure(
                self.fit.spline, self._for_display(), points, self.fit.residuals, gap=float(self.fit.gap), title=title
            )
            with targets["figure"].open() as path:
                save_figure(figure, path, ending=targets["figure"].ending)

    def _for_display(self) -> Any:
        """The mesh, or one with smooth outlines where it has few triangles: edges halved, on the zero set again."""
        drawn = self.mesh
        while drawn is not None and len(drawn.faces) < FEW_TRIANGLES:
            drawn = drawn.subdivide()
            vertices = drawn.vertices.copy()
            feet, reached = self.fit.field.project(vertices)
            # caps where the box cuts the shape are not on the zero set, and stay
            moved = reached & (((feet - vertices) ** 2).sum(axis=1) < drawn.area / len(drawn.faces))
            vertices[moved] = feet[moved]
            drawn.vertices = vertices
        return drawn

    def _write_mesh(self, target: Target) -> None:
        from tspline.errors import VanishedError
        from tspline.export.mesh_file import save_mesh

        if self.mesh is None:
            raise VanishedError(f"--mesh {target.name}: there is no surface to write; {self.fit.message}")
        with target.open() as path:
            # saving may itself go by a temporary file and refuse to replace one
            path.unlink(missing_ok=True)
            save_mesh(self.mesh, path, ending=target.ending)

    def values(self, targets: Mapping[str, Target]) -> dict[str, Any]:
        """What the JSON object holds of surfaces only; area and volume where a mesh was asked for."""
        asked = "mesh" in targets and self.mesh is not None
        return {
            "genus": self.genus,
            "area": float(self.mesh.area) if asked else None,
            "volume": float(self.mesh.volume) if asked else None,
        }
