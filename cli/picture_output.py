"""What ``tspline segment`` writes and tells in the geometry of the picture: masks, labels, contours, meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cli.outputs import Target

if TYPE_CHECKING:
    from segment.picture import Picture

__all__ = ["SolidResult", "geometry_values", "image_scene", "write_planar", "write_samples"]


def write_samples(targets: Mapping[str, Target], picture: Picture, result: Any) -> None:
    """Write mask and labels, or classes, where asked for; what was not asked for is not touched."""
    from segment.picture import write_labels, write_mask

    if "mask" in targets:
        with targets["mask"].open() as path:
            write_mask(path, result.mask, picture, ending=targets["mask"].ending)
    if "labels" in targets:
        numbers = result.labels if result.classes is None else result.classes
        with targets["labels"].open() as path:
            write_labels(path, numbers, picture, ending=targets["labels"].ending)


def write_planar(targets: Mapping[str, Target], picture: Picture, result: Any) -> None:
    """Write the contours of an image where asked for, with physical coordinates where the picture has them.

    Of an image in classes those of all classes, each numbered by its class.
    """
    if "contour" not in targets:
        return
    from segment.edge_targets import along_border
    from tspline.export.contour_file import ContourFrame, write_contours

    geometry = picture.geometry
    spacing = geometry.spacing if geometry.is_physical else None
    frame = ContourFrame.of_image(picture.shape, spacing=spacing, unit=geometry.unit, place=_place(picture))
    lines, labels, border = result.contours, result.contour_labels, result.contour_flags
    if result.classes is not None:
        lines = [line for found in result.phase_contours for line in found]
        labels = [number for number, found in enumerate(result.phase_contours) for _ in found]
        border = [along_border(line, result.classes.shape) for line in lines]
    with targets["contour"].open() as path:
        write_contours(path, lines, frame, border=border, labels=labels, ending=targets["contour"].ending)


def _place(picture: Picture) -> dict[str, Any]:
    """Where the plane lies in a body, for those who want its coordinates there."""
    geometry = picture.geometry
    if not geometry.is_anatomical:
        return {}
    below, right = (geometry.steps[:, geometry.axes] / geometry.spacing).T
    return {
        "world": geometry.world,
        "origin": geometry.origin.tolist(),
        "x_direction": right.tolist(),
        "y_direction": below.tolist(),
    }


def image_scene(picture: Picture) -> Any:
    """The stage of an image's figures; of channels that are no colours, the first is shown."""
    from tspline.figure.scene import ImageScene

    odd = picture.has_channels and picture.num_channels != 3
    return ImageScene(picture.pixels[:, :, 0] if odd else picture.pixels)


def geometry_values(picture: Picture) -> dict[str, Any]:
    """What the JSON object holds of the geometry."""
    geometry = picture.geometry
    known = geometry.is_physical
    return {
        "dim": len(picture.shape),
        "shape": [int(extent) for extent in picture.shape],
        "spacing": [float(side) for side in picture.spacing] if known else None,
        "unit": geometry.unit or None,
        "world": geometry.world,
    }


@dataclass(frozen=True)
class SolidResult:
    """A segmented volume, with its mesh where one was needed."""

    result: Any
    """`segment.SegmentResult`."""
    picture: Picture
    mesh: Any
    """trimesh.Trimesh in the coordinates of the field; None where no output needs one, or where nothing was found."""

    @classmethod
    def of(cls, result: Any, picture: Picture, targets: Mapping[str, Target]) -> SolidResult:
        """Make the mesh if one of the targets needs it."""
        needed = result.num_components > 0 and ("mesh" in targets or "figure" in targets)
        mesh = result.to_mesh() if needed else None
        return cls(result, picture, mesh if mesh is not None and len(mesh.faces) else None)

    def write(self, targets: Mapping[str, Target], title: str) -> None:
        """Write the mesh, in the picture's world, and the figure where asked for.

        Raises
        ------
        VanishedError
            A mesh is asked for and there is no surface.
        """
        if "mesh" in targets:
            self._write_mesh(targets["mesh"])
        if "figure" in targets:
            from tspline.figure.evolution import save_figure
            from tspline.figure.volume import volume_figure

            known = self.picture.geometry.is_physical
            spacing = self.picture.spacing if known else (1.0, 1.0, 1.0)
            figure = volume_figure(self.result.spline, self.mesh, self.picture.pixels, spacing, title=title)
            with targets["figure"].open() as path:
                save_figure(figure, path, ending=targets["figure"].ending)

    def _write_mesh(self, target: Target) -> None:
        from segment.picture.world_mesh import world_mesh
        from tspline.errors import VanishedError
        from tspline.export.mesh_file import is_unit, save_mesh

        if self.mesh is None:
            raise VanishedError(f"--mesh {target.name}: there is no surface to write; {self.result.message}")
        geometry = self.picture.geometry
        unit = geometry.unit if is_unit(geometry.unit) else None
        world = geometry.world if geometry.is_anatomical else None
        with target.open() as path:
            # saving goes by a temporary file and refuses to replace one
            path.unlink(missing_ok=True)
            save_mesh(world_mesh(self.mesh, geometry), path, units=unit, world=world, ending=target.ending)

    def values(self, targets: Mapping[str, Target]) -> dict[str, Any]:
        """What the JSON object holds of volumes only; measures where a mesh was asked for, in the picture's unit."""
        mesh = self.mesh if "mesh" in targets else None
        return {
            "genus": None if mesh is None else int(mesh.body_count) - int(mesh.euler_number) // 2,
            "area": None if mesh is None else float(mesh.area),
            "volume": None if mesh is None else float(mesh.volume),
        }
