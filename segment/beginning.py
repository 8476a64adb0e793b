"""Where a contour begins that does not have to shrink: by edges or by the statistics of regions."""

from __future__ import annotations

from dataclasses import replace

from segment.choice import edges_suffice, through_an_eyepiece
from segment.edges import EdgeField
from segment.pyramid import PyramidLevel
from segment.region_start import Found, RegionStart
from segment.start import Start, chamber_start
from segment.uneven import field_of_view

__all__ = ["beginning"]


def beginning(
    levels: list[PyramidLevel], edges: EdgeField, start: Start, model: str = "auto", statistics: str = "auto"
) -> Found:
    """The inside to begin with, and the level that it was found on.

    Parameters
    ----------
    levels : list of PyramidLevel
        From the full image to the coarsest.
    edges : EdgeField
        Of the coarsest level.
    start : Start
    model : "auto", "edges" or "regions"
        "auto" takes the chambers of the edges where these explain the edges of the image, and labels else.
    statistics : str
        As for `RegionStart`.
    """
    coarse = levels[-1]
    if model != "regions":
        inside = chamber_start(edges, start)
        box = start.shrunk_region(coarse.shape) if start.boxed else None
        wanted = start.seeds is not None or start.strokes is not None
        if model == "edges" or (
            edges_suffice(edges, inside, box, start.domain(coarse.shape)) and (inside.any() or not wanted)
        ):
            return Found(inside, coarse)
    eyepiece = False
    if statistics in ("auto", "local") and not start.has_place:
        # The strongest edge is the frame's, not an object's, and inside it light is uneven.
        eyepiece = through_an_eyepiece(edges, field_of_view(coarse))
    found = RegionStart(levels, start, "local" if eyepiece else statistics, thin=eyepiece).find()
    return replace(found, inside=start.heeded(found.inside, found.level))
