"""Real images and volumes with truth: this toolkit beside GrabCut, thresholds, Chan-Vese, snakes and level sets.

usage: regions.py [--data FOLDER] [--only coins,seastar] [--peer-only] [--json]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import measured
import numpy as np
import numpy.typing as npt
import region_peers as peers
import report
from scipy import ndimage
from truth import Box, Data, Mask, add_option, box_mask, disc_mask, iou

Image = npt.NDArray[Any]
Program = Callable[..., Mask]


@dataclass(frozen=True)
class Start:
    """Where every program of a case begins: a box, a disc inside the object, or nothing (the default call)."""

    box: Box | None = None
    disc: tuple[float, float, float] | None = None
    """Row, column and radius."""

    def mask(self, shape: tuple[int, ...]) -> Mask:
        """Pixels of the start; all of them where nothing is said."""
        if self.box is not None:
            return box_mask(shape, self.box)
        if self.disc is not None:
            return disc_mask(shape, self.disc[:2], self.disc[2])
        return np.ones(shape, dtype=bool)

    def ours(self, shape: tuple[int, ...]) -> Any:
        """The same as `init` of `segment_image`."""
        return self.box if self.box is not None else None if self.disc is None else self.mask(shape)

    def __str__(self) -> str:
        if self.disc is not None:
            return "disc at ({:g}, {:g}), radius {:g}".format(*self.disc)
        return "none" if self.box is None else f"box {self.box}"


@dataclass(frozen=True)
class Peer:
    """A program and the options tried; the best by IoU with the truth is shown, which no user knows."""

    name: str
    run: Program
    grid: Sequence[dict[str, Any]] = ({},)


@dataclass(frozen=True)
class Case:
    """An image with truth, its start, its peers, and the IoU and boundary F that were promised."""

    start: Start
    peers: Sequence[Peer]
    iou: float | None
    """None: no worse than the best peer."""
    boundary: float | None = None


def snakes(steps: int, balloon: float) -> Peer:
    """The morphological snake with scikit-image's choice of threshold, at two scales."""
    grid = [{"steps": steps, "balloon": balloon, "sigma": sigma} for sigma in (1.0, 2.0)]
    return Peer("scikit-image snake, tuned", peers.morphological_edges, grid)


def edge_grid(propagation: float) -> list[dict[str, Any]]:
    """Scales and sigmoids of ITK's geodesic active contour."""
    return [{"sigma": s, "middle": m, "propagation": propagation} for s in (1.0, 2.0) for m in (0.1, 0.25)]


GRABCUT = Peer("GrabCut, default", peers.grabcut)
OTSU = Peer("Otsu", peers.otsu)
REGIONS = Peer("scikit-image morphological Chan-Vese", peers.morphological_regions, [{"steps": 40}])
MEANS = Peer("scikit-image Chan-Vese, tuned", peers.two_means, [{"mu": mu, "steps": 50} for mu in (0.02, 0.1)])
LEVELS = [{"iterations": n, "sigma": s, "dark": 30, "bright": 150} for n, s in ((1, 1.0), (5, 0.0))]
"""Grey values as in scikit-image's gallery example on the coins."""
CASES = {
    "coins": Case(
        Start(),
        [
            Peer("GrabCut, default, box 10 % larger", partial(peers.grabcut_box, box=(2, 0, 302, 383))),
            Peer("GrabCut, tuned", peers.grabcut_levels, LEVELS),
            Peer("GrabCut, tuned, light evened", peers.grabcut_otsu, [{"iterations": 2, "sigma": 1.0, "flat": 101}]),
            OTSU,
            Peer("local threshold, tuned", peers.local_threshold, [{"block": 151, "offset": -10, "fill": True}]),
            REGIONS,
            MEANS,
            snakes(230, -1.0),
        ],
        None,
    ),
    "seastar": Case(
        Start(box=(7, 8, 300, 266)),
        [
            GRABCUT,
            Peer("GrabCut, tuned", peers.grabcut, [{"sigma": s, "lab": lab} for s in (0.0, 1.0) for lab in (0, 1)]),
            OTSU,
            REGIONS,
            MEANS,
            snakes(150, -1.0),
            Peer("SimpleITK geodesic contour, tuned", peers.itk_edges, edge_grid(-1.0)),
        ],
        None,
    ),
    "nuclei_256": Case(
        Start(),
        [
            Peer("GrabCut from Otsu", peers.grabcut_otsu),
            OTSU,
            Peer("local threshold, tuned", peers.local_threshold, [{"block": 35, "offset": -10}]),
            REGIONS,
            MEANS,
        ],
        0.80,
        0.88,
    ),
    "t1brain_ax30": Case(
        Start(disc=(122, 123, 30)),
        [
            Peer("GrabCut, default, box 10 % larger", partial(peers.grabcut_box, box=(51, 43, 192, 194))),
            Peer("SimpleITK threshold level set, tuned", peers.itk_range, [{"width": w} for w in (2.0, 2.5, 3.0)]),
            Peer("SimpleITK confidence connected", peers.itk_confidence, [{"multiplier": 2.5}]),
            Peer("SimpleITK geodesic contour, tuned", peers.itk_edges, edge_grid(1.0)),
            OTSU,
            REGIONS,
            snakes(100, 1.0),
        ],
        0.86,
    ),
    "chase_01L": Case(
        Start(),
        [
            Peer("Otsu of the green channel", partial(peers.green, run=peers.otsu, dark=True)),
            Peer(
                "local threshold of the green channel, tuned",
                partial(peers.green, run=peers.local_threshold, dark=True),
                [{"block": b, "offset": -4, "sigma": 2.0} for b in (75, 101)],
            ),
        ],
        0.50,
    ),
    "vol_mni_wm": Case(
        Start(),
        [
            OTSU,
            Peer("Otsu, 3 classes of the voxels that are not 0", peers.otsu_brightest, [{"above": 0}]),
            Peer("Otsu, 3 classes of all voxels", peers.otsu_brightest),
            REGIONS,
        ],
        0.75,
    ),
    "vol_nuclei": Case(
        Start(),
        [
            OTSU,
            Peer("local threshold, tuned", peers.local_threshold, [{"block": 15, "offset": -3, "sigma": 1.0}]),
            REGIONS,
        ],
        0.66,
    ),
}


def field_of_view(image: Image) -> Mask:
    """The lit disc of a photograph of the retina: the largest part of what is red, without holes."""
    lit = ndimage.binary_fill_holes(ndimage.gaussian_filter(image[..., 0].astype(np.float64), 2) > 30)
    labels, _ = ndimage.label(lit)
    largest: Mask = labels == np.bincount(labels.ravel())[1:].argmax() + 1
    return largest


def load(data: Data, name: str) -> tuple[Image, npt.NDArray[Any]]:
    """Image and truth; 128 is not scored."""
    if name.startswith("vol_"):
        return data.volume(name)
    image, truth = data.photograph(name)
    if name.startswith("chase"):
        truth = np.where(field_of_view(image), truth, 128).astype(np.uint8)
    return image, truth


def ours(image: Image, init: Any) -> Mask:
    """Default options."""
    from segment import segment_image

    mask: Mask = segment_image(image, init=init).mask
    return mask


def small(image: Image) -> tuple[Image, Mask]:
    """A bright disc or ball of the image's kind, to load and start what is not to be timed, and a start in it."""
    spatial = image.shape[:2] if image.shape[-1] == 3 else image.shape
    side = 64 if len(spatial) == 2 else 20
    grid = np.indices((side,) * len(spatial)) - side / 2
    inside = (grid**2).sum(axis=0) < (side / 4) ** 2
    shades = np.where(inside, 180, 20) + 10 * np.sin(grid[0])
    picture = np.repeat(shades[..., None], 3, axis=-1) if image.shape[-1] == 3 else shades
    return picture.astype(np.uint8), inside


def row(data: Data, name: str, run: Program, arguments: tuple[Any, ...], first: tuple[Any, ...]) -> dict[str, Any]:
    """Scores and costs of one program in a process of its own."""
    _, truth = load(data, name)
    try:
        got = measured.fresh(run, *arguments, first=first)
    except RuntimeError as error:  # a program that fails is a row of the table
        return {"IoU": None, "remark": str(error)[:60]}
    mask = got.result
    if truth.dtype != bool:
        mask = mask & (truth != 128)
    score = data.score_mask(mask, truth)
    return {
        "IoU": score["iou"],
        "boundary F": score["boundary_f2"],
        "mean distance px": score["mean_boundary_distance"],
        "components": score["components"],
        "CPU s": got.cpu,
        "MB more": got.growth,
    }


def table(data: Data, name: str, case: Case, peer_only: bool) -> list[dict[str, Any]]:
    """Ours first, then the peers with the best of their options."""
    image, truth = load(data, name)
    spatial = truth.shape
    start, (tiny, inside) = case.start.mask(spatial), small(image)
    rows = []
    if not peer_only:
        scores = row(data, name, ours, (image, case.start.ours(spatial)), (tiny, None))
        rows.append({"program": "tspline", "options": "defaults"} | scores)
    scored, sure = (truth != 128, truth > 128) if truth.dtype != bool else (np.ones(spatial, dtype=bool), truth)
    for peer in case.peers:
        best = max(
            peer.grid,
            key=lambda options: iou(peer.run(image, start, **options) & scored, sure & scored),
        )
        run = partial(peer.run, **best)
        options = ", ".join(f"{key} {value}" for key, value in best.items()) or "defaults"
        rows.append({"program": peer.name, "options": options} | row(data, name, run, (image, start), (tiny, inside)))
    rows[0]["promised IoU"] = case.iou if case.iou else max(each["IoU"] or 0.0 for each in rows[not peer_only :])
    rows[0]["promised F"] = case.boundary
    return rows


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--only", default=",".join(CASES), help="cases, by name")
    options.add_argument("--peer-only", action="store_true", help="only what the other programs do")
    chosen = options.parse_args()
    data = Data(chosen.data)
    tables = {
        f"{name}, start: {CASES[name].start}": table(data, name, CASES[name], chosen.peer_only)
        for name in chosen.only.split(",")
    }
    report.publish("regions", tables, chosen.json)


if __name__ == "__main__":
    main()
