"""Figure 5 of the paper: T-meshes by subdivision, from points (4.2) and from an image (4.1).

usage: figure_5_tmesh.py [--out FOLDER]
"""

from __future__ import annotations

from pathlib import Path

from example_1_points import cloud
from example_1_points import fit as fit_cloud
from example_2_image import scene
from example_2_image import segment as segment_scene
from example_arguments import main

from tspline import TSpline
from tspline.figure import Recorder, theme
from tspline.figure.evolution import save_figure
from tspline.figure.scene import ImageScene, PointScene, Scene


def subdivision(recorder: Recorder, result: TSpline) -> list[TSpline]:
    """One spline for each mesh of a run, from coarse to fine; meshes of equal size count as one."""
    splines = {shot.spline.num_coefficients: shot.spline for shot in recorder.snapshots()}
    splines[result.num_coefficients] = result
    return [splines[size] for size in sorted(splines)]


def draw(path: Path, data: Scene, splines: list[TSpline]) -> None:
    """The data and each mesh in a panel of its own."""
    figure = theme.new_figure(3.4 * len(splines), 3.65)
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.02, top=0.93, wspace=0.05)
    for axes, spline in zip(figure.subplots(1, len(splines), squeeze=False)[0], splines, strict=True):
        data.draw_data(axes)
        data.draw_mesh(axes, spline)
        axes.set_title(f"{spline.mesh.num_cells:,} cells, {spline.num_coefficients:,} coefficients", fontsize=9)
    save_figure(figure, path)


def run(out: Path) -> dict[str, float]:
    """Draw both families of meshes, and return the size of the finest of each."""
    points, (image, _) = cloud(), scene()
    of_points, of_image = Recorder(), Recorder()
    fitted = fit_cloud(points, of_points).spline
    segmented = segment_scene(image, of_image).spline
    families: dict[str, tuple[Scene, list[TSpline]]] = {
        "points": (PointScene(points, fitted.bounds), subdivision(of_points, fitted)),
        "image": (ImageScene(image), subdivision(of_image, segmented)),
    }
    figures: dict[str, float] = {}
    for name, (data, splines) in families.items():
        draw(out / f"figure_5_{name}.png", data, splines)
        finest = splines[-1]
        figures[f"{name}_meshes"] = len(splines)
        figures[f"{name}_cells"] = finest.mesh.num_cells
        figures[f"{name}_coefficients"] = finest.num_coefficients
        figures[f"{name}_uniform"] = (2**finest.mesh.depth + 3) ** 2  # a tensor product of the same depth
    return figures


if __name__ == "__main__":
    main(run, __doc__)
