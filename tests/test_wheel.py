"""The built wheel works in a fresh environment, away from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

PACKAGES = ("tspline", "recon", "segment", "cli")

pytestmark = pytest.mark.skipif(
    any(not list(metadata.distributions(name=name)) for name in ("maturin", "pip")),
    reason="needs maturin and pip in the running environment: the test extra has them",
)


def call(command: list[str], folder: Path, **variables: str) -> str:
    """Standard output of a command that has to succeed, run in a folder with a clean Python path."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment | variables,
        capture_output=True,
        text=True,
        timeout=540,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release wheel; Cargo finds the results of the installation again in the checkout's target folder."""
    out = tmp_path_factory.mktemp("wheel")
    options = ["--no-build-isolation", "--no-deps", "--no-cache-dir", "--wheel-dir", str(out)]
    scripts = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    call([sys.executable, "-m", "pip", "wheel", *options, str(root)], root, PATH=scripts)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Interpreter of a fresh environment with the wheel, which borrows this environment's dependencies."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder, symlinks=os.name != "nt")
    paths = sysconfig.get_paths(vars={"base": str(folder), "platbase": str(folder)})
    # Lines of a .pth file are appended: what the wheel installs comes first, and .pth files of the borrowed
    # folder (the checkout's editable installation is one) are not followed.
    borrowed = sorted({sysconfig.get_path(kind) for kind in ("purelib", "platlib")})
    Path(paths["purelib"], "borrowed.pth").write_text("\n".join(borrowed) + "\n", encoding="utf-8")
    python = Path(paths["scripts"], "python")
    # --ignore-installed: the borrowed folder also has the editable installation's metadata.
    options = ["--no-deps", "--no-index", "--ignore-installed", "--quiet", str(wheel)]
    call([sys.executable, "-m", "pip", "--python", str(python), "install", *options], folder)
    return python


def test_tag_is_abi3(wheel: Path) -> None:
    name, version, interpreter, abi, _platform = wheel.stem.split("-")
    assert name == "tspline"
    assert version == metadata.version("tspline")
    assert (interpreter, abi) == ("cp310", "abi3")


def test_contents(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    for package in PACKAGES:
        assert f"{package}/__init__.py" in names
        assert f"{package}/py.typed" in names
    assert "tspline/_core.pyi" in names
    assert {f"tspline/figure/page/page.{ending}" for ending in ("css", "html", "js")} <= set(names)
    assert len([name for name in names if name.startswith("tspline/_core") and not name.endswith(".pyi")]) == 1
    strangers = {name.split("/")[0] for name in names if not name.startswith("tspline-")} - set(PACKAGES)
    # A repaired wheel may bring shared libraries of its own.
    assert strangers <= {"tspline.libs"}
    assert any(name.endswith("/LICENSE") for name in names)


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_imports_away_from_the_checkout(python: Path, root: Path, package: str) -> None:
    code = f"import {package}; print({package}.__file__)"
    place = Path(call([str(python), "-c", code], python.parents[1]).strip()).resolve()
    assert place.is_relative_to(python.parents[1].resolve())
    assert not place.is_relative_to(root)


def test_libraries_do_not_load_the_plotting_library(python: Path) -> None:
    code = "import sys, tspline, recon, segment, cli.main; print('matplotlib' in sys.modules)"
    assert call([str(python), "-c", code], python.parents[1]).strip() == "False"


def test_the_command_is_ours(python: Path) -> None:
    """`cli` is a common name: the script has to find this project's."""
    out = call([str(python.parent / "tspline"), "--version"], python.parents[1])
    assert metadata.version("tspline") in out
