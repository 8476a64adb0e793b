"""Imports point one way, as CONTRIBUTING.md describes: walked by `ast`, nothing is run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGES = {  # package: the other packages of this project that it may import
    "tspline": set(),
    "recon": {"tspline"},
    "segment": {"tspline"},
    "cli": {"tspline", "recon", "segment"},
}
# From the bottom up: a part may import only what stands before it.
ORDER = [
    *(
        "errors",
        "atomic",
        "_core",
        "array_file",
        "model_archive",
        "mesh",
        "field",
        "spline",
        "model_file",
        "grid",
        "geometry",
        "distance",
    ),
    *("speed", "contour", "agreement", "evolve", "sparse_field", "export", "figure", "morph", "edit"),
]
# Pairs that do not know each other although one stands before the other.
STRANGERS = {("sparse_field", "evolve")}
# A method that is a convenience for a function further up: imported on use.
UPWARD = {("spline", "model_file"), ("field", "geometry"), ("field", "contour"), ("model_file", "grid")}
# Heavy or optional: imported inside the function that needs them, so that `import tspline` starts at once.
# The figures' own modules draw with matplotlib throughout, and are themselves imported on use.
ON_USE = {
    "matplotlib",
    "mpl_toolkits",
    "ezdxf",
    "vtk",
    "laspy",
    "pye57",
    "trimesh",
    "nibabel",
    "nrrd",
    "pydicom",
    "distributed",
}
DRAWING = ("tspline", "figure")


class Import(NamedTuple):
    """One import statement: where it stands and the dotted name that it reads."""

    path: Path
    line: int
    name: str
    on_use: bool


def imports(path: Path, root: Path) -> Iterator[Import]:
    """All imports of a file, relative ones resolved, with those inside functions marked."""
    module = path.relative_to(root).with_suffix("").parts
    package = module[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    typing_only = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.dump(n.test)]
    inner = {id(n) for outer in (*functions, *typing_only) for n in ast.walk(outer)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else ()
            base = [*start, *(node.module.split(".") if node.module else [])]
            # `from tspline import mesh` reads the part as much as `from tspline.mesh import ...` does.
            names = [".".join([*base, alias.name]) for alias in node.names]
        else:
            continue
        for name in names:
            yield Import(path, node.lineno, name, id(node) in inner)


def part_of(parts: tuple[str, ...]) -> str | None:
    """The part of `tspline` that a dotted name belongs to; none for the package's own names."""
    return parts[1] if len(parts) > 1 and parts[1] in ORDER else None


def broken_rules(found: Import, root: Path) -> Iterator[str]:
    """What an import does that it may not do."""
    here = found.path.relative_to(root).with_suffix("").parts
    target = tuple(found.name.split("."))
    if target[0] in ON_USE and not found.on_use and here[:2] != DRAWING:
        yield f"{target[0]} is imported on use, inside a function"
    if target[0] not in PACKAGES:
        return
    if target[0] != here[0]:
        if target[0] not in PACKAGES[here[0]]:
            yield f"{here[0]} may not import {target[0]}"
        return
    if here[0] != "tspline":
        return
    own, other = part_of(here), part_of(target)
    if own is None:
        return
    if other is None:
        yield f"tspline.{own} imports from the top of the package ({found.name}): name the part"
    elif (own, other) in UPWARD and found.on_use:
        return
    elif ORDER.index(other) > ORDER.index(own) or (own, other) in STRANGERS:
        yield f"tspline.{own} may not import tspline.{other}"


def sources(root: Path) -> list[Path]:
    return sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))


def test_imports_point_one_way(root: Path) -> None:
    broken = [
        f"{found.path.relative_to(root)}:{found.line}: {rule}"
        for path in sources(root)
        for found in imports(path, root)
        for rule in broken_rules(found, root)
    ]
    assert not broken, "\n".join(broken)


def test_every_part_has_its_place_in_the_order(root: Path) -> None:
    inside = (root / "tspline").iterdir()
    parts = {path.stem for path in inside if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert parts - {"__init__"} <= set(ORDER)


@pytest.mark.parametrize(
    ("place", "line", "rule"),
    [
        (
            "tspline/mesh.py",
            "from tspline.spline import TSpline",
            "tspline.mesh may not import tspline.spline",
        ),
        ("tspline/mesh.py", "from . import spline", "tspline.mesh may not import tspline.spline"),
        ("tspline/speed/edge.py", "from ..evolve import step", "tspline.speed may not import tspline.evolve"),
        (
            "tspline/sparse_field/run.py",
            "import tspline.evolve",
            "tspline.sparse_field may not import tspline.evolve",
        ),
        ("tspline/evolve/run.py", "import tspline", "tspline.evolve imports from the top"),
        ("tspline/errors.py", "import recon", "tspline may not import recon"),
        ("recon/fit.py", "from segment.image import ImageData", "recon may not import segment"),
        ("segment/image.py", "import cli.main", "segment may not import cli"),
        ("tspline/export/svg.py", "from matplotlib.path import Path", "matplotlib is imported on use"),
        ("cli/fit.py", "import matplotlib.figure", "matplotlib is imported on use"),
    ],
)
def test_a_wrong_import_is_found(tmp_path: Path, place: str, line: str, rule: str) -> None:
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    found = [text for item in imports(path, tmp_path) for text in broken_rules(item, tmp_path)]
    assert len(found) == 1
    assert found[0].startswith(rule)


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ("tspline/evolve/run.py", "from tspline.contour import samples"),
        ("tspline/evolve/run.py", "from .system import System"),
        ("tspline/__init__.py", "from .evolve import Evolution"),
        ("cli/fit.py", "import recon, segment, tspline"),
        ("tspline/figure/panels.py", "from matplotlib.figure import Figure"),
        ("cli/fit.py", "def draw():\n    from matplotlib.figure import Figure"),
        (
            "cli/fit.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from matplotlib.figure import Figure",
        ),
    ],
)
def test_a_right_import_passes(tmp_path: Path, place: str, line: str) -> None:
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    assert not [text for item in imports(path, tmp_path) for text in broken_rules(item, tmp_path)]
