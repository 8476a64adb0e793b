"""Figure and animation of a run, written where they were asked for."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cli.arguments import UsageError
from cli.outputs import OutputKind, Target

if TYPE_CHECKING:
    from tspline.figure import Recorder, Snapshot
    from tspline.figure.scene import Scene

__all__ = [
    "ANIMATION",
    "CONTOUR",
    "FIGURE",
    "MODEL",
    "callbacks",
    "need_recorder",
    "refuse_animation",
    "write_drawings",
    "write_model",
]

MODEL = OutputKind("model", (".npz", ".tsp.npz"), default_ending=".tsp.npz")
FIGURE = OutputKind("figure", (".png", ".pdf", ".svg"), default_ending=".png")
ANIMATION = OutputKind("animation", (".gif",))
CONTOUR = OutputKind("contour", (".geojson", ".svg", ".dxf"))


def need_recorder(options: Collection[str]) -> Recorder | None:
    """A recorder where a figure, an animation or a report is asked for."""
    if not {"figure", "animation", "report"}.intersection(options):
        return None
    from tspline.figure import Recorder

    return Recorder()


def refuse_animation(options: argparse.Namespace) -> None:
    """Refuse an animation of the grid solver; its figures show the result alone, as a T-spline."""
    if options.solver == "grid" and options.animation:
        raise UsageError("--animation shows the steps of T-splines, found --solver grid; accepted is --solver tspline")


def callbacks(*given: Callable[[Any], Any] | None) -> Callable[[Any], bool] | None:
    """One callback that calls all given ones; None if there is none."""
    called = [callback for callback in given if callback is not None]
    if not called:
        return None

    def call_all(step: Any) -> bool:
        for callback in called:
            callback(step)
        return False

    return call_all


def write_drawings(
    targets: Mapping[str, Target],
    scene: Callable[[Sequence[Snapshot]], Scene],
    recorder: Recorder | None,
    spline: Any,
    *,
    title: str,
    detail: str = "",
    certainty: tuple[Sequence[Any], Sequence[Any]] | None = None,
) -> None:
    """Write the figure and the animation.

    `scene` makes the stage for the snapshots if one is asked for; `certainty` holds the contours of an image and their
    uncertainties.
    """
    if recorder is None:
        return
    snapshots = recorder.snapshots(spline)
    stage = scene(snapshots)
    if "figure" in targets:
        from tspline.figure.evolution import evolution_figure, save_figure
        from tspline.figure.uncertainty import Certainty

        sure = None if certainty is None else Certainty(*certainty)
        figure = evolution_figure(stage, snapshots, title=title, detail=detail, certainty=sure)
        with targets["figure"].open() as path:
            save_figure(figure, path, ending=targets["figure"].ending)
    if "animation" in targets:
        from tspline.figure.animation import write_animation

        with targets["animation"].open() as path:
            write_animation(path, stage, snapshots)


def write_model(targets: Mapping[str, Target], spline: Any) -> None:
    """Write the model file."""
    if "model" in targets:
        with targets["model"].open() as path:
            # saving may itself go by a temporary file and refuse to replace one
            path.unlink(missing_ok=True)
            spline.save(path)
