"""Where results go: names are worked out and checked for all inputs before anything is computed."""

from __future__ import annotations

import importlib.util
import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from cli.arguments import UsageError
from cli.inputs import Input

__all__ = ["OutputKind", "Target", "plan_outputs", "plan_run_outputs"]


_PACKAGES = {
    ".dxf": ("ezdxf", "dxf"),
    ".nii": ("nibabel", "medical"),
    ".nii.gz": ("nibabel", "medical"),
    ".nrrd": ("nrrd", "medical"),
}
"""Packages that formats need, with the extra that brings them."""


@dataclass(frozen=True)
class OutputKind:
    """A kind of result that can be written."""

    option: str
    """Name of the option without dashes, and key of the plan."""
    endings: tuple[str, ...]
    """Accepted endings; the first is written to standard output."""
    default_ending: str = ""
    """Ending of the file written when no output is asked for; empty: not written then."""


@dataclass(frozen=True)
class Target:
    """One file to be written, or standard output."""

    name: str
    """As the user named it, or ``-``."""
    ending: str
    """Which format."""
    force: bool

    @property
    def is_stdout(self) -> bool:
        """Whether the result goes to standard output."""
        return self.name == "-"

    @contextmanager
    def open(self) -> Iterator[Path]:
        """Give a temporary file to write; it becomes the target when the block ends without an error."""
        import shutil
        import tempfile

        from tspline.atomic import complete_or_absent

        if not self.is_stdout:
            with complete_or_absent(self.name, force=self.force) as path:
                yield path
            return
        with tempfile.TemporaryDirectory(prefix="tspline-") as folder:
            path = Path(folder) / f"stdout{self.ending}"
            yield path
            with path.open("rb") as source:
                shutil.copyfileobj(source, sys.stdout.buffer)
            sys.stdout.buffer.flush()


def plan_outputs(
    inputs: Sequence[Input],
    kinds: Sequence[OutputKind],
    templates: Mapping[str, str | None],
    *,
    force: bool,
    json: bool,
    default: bool = True,
) -> list[dict[str, Target]]:
    """Name every output of every input, and refuse what could not be written.

    Parameters
    ----------
    inputs : sequence of Input
    kinds : sequence of OutputKind
        What the command can write.
    templates : mapping
        The value of each kind's option; ``{stem}`` stands for the input's name without ending, ``{folder}`` for the
        name of the folder that it lies in.
    force, json : bool
        The options of these names.
    default : bool
        Whether files of the kinds with a default ending are written where none is asked for.

    Returns
    -------
    list of dict
        For each input its targets by option; what was not asked for is not there.

    Raises
    ------
    UsageError
        A wrong ending, a missing folder, a file that exists (without `force`), two outputs of one name, an
        output that is an input, or ``-`` where standard output is taken.
    """
    asked = {kind: template for kind in kinds if (template := templates.get(kind.option)) is not None}
    if not asked:
        return _default_plan(inputs, kinds) if default else [{} for _ in inputs]
    plan = [{kind.option: _target(kind, template, item, force) for kind, template in asked.items()} for item in inputs]
    _check_stdout(plan, json=json)
    _check_distinct(plan, inputs)
    for targets in plan:
        for target in targets.values():
            if not target.is_stdout:
                _check_writable(target)
    return plan


def plan_run_outputs(
    inputs: Sequence[Input],
    plan: Sequence[Mapping[str, Target]],
    kinds: Sequence[OutputKind],
    templates: Mapping[str, str | None],
    *,
    force: bool,
    json: bool,
) -> dict[str, Target]:
    """Name the outputs of the whole run, such as tables, beside those of the inputs in `plan`.

    Raises
    ------
    UsageError
        As `plan_outputs`, and for ``{stem}``.
    """
    targets = {}
    for kind in kinds:
        template = templates.get(kind.option)
        if template is None:
            continue
        if re.search(r"\{[^{}/]*\}", template):
            raise UsageError(f"--{kind.option} {template}: is one file for all inputs; accepted is a plain name")
        targets[kind.option] = _target(kind, template, Input("-"), force)
    if not targets:
        return {}
    everything = [*plan, targets]
    _check_stdout(everything, json=json)
    _check_distinct(everything, inputs)
    for target in targets.values():
        if not target.is_stdout:
            _check_writable(target)
    return targets


def _target(kind: OutputKind, template: str, item: Input, force: bool) -> Target:
    if template == "-":
        return Target("-", kind.endings[0], force)
    wrong = [word for word in re.findall(r"\{[^{}/]*\}", template) if word not in ("{stem}", "{folder}")]
    if wrong:
        raise UsageError(f"--{kind.option} {template}: found {wrong[0]}; accepted is {{stem}} or {{folder}}")
    name = template.replace("{stem}", item.stem).replace("{folder}", item.folder)
    if os.path.exists(name) and _is_device(name):
        return Target(name, kind.endings[0], force)
    ending = next((e for e in sorted(kind.endings, key=len, reverse=True) if name.lower().endswith(e)), None)
    if ending is None:
        found = Path(name).suffix
        what = f"the ending {found!r}" if found else "no ending"
        raise UsageError(f"--{kind.option} {name}: found {what}; accepted is {' '.join(kind.endings)}")
    package, extra = _PACKAGES.get(ending, ("", ""))
    if package and importlib.util.find_spec(package) is None:
        needed = f"{ending} needs the package {package}: pip install 'tspline[{extra}]'"
        raise UsageError(f"--{kind.option} {name}: {needed}")
    return Target(name, ending, force)


def _default_plan(inputs: Sequence[Input], kinds: Sequence[OutputKind]) -> list[dict[str, Target]]:
    """Files in the current folder, with a number where a name is taken."""
    taken: set[str] = set()
    plan = []
    for item in inputs:
        for number in count():
            stem = item.stem + (f"-{number}" if number else "")
            names = {kind: stem + kind.default_ending for kind in kinds if kind.default_ending}
            if not any(name in taken or os.path.lexists(name) for name in names.values()):
                break
        taken.update(names.values())
        plan.append({kind.option: Target(name, kind.default_ending, False) for kind, name in names.items()})
    if not os.access(".", os.W_OK):
        raise UsageError(f"{os.getcwd()}: the current folder cannot be written to; accepted is an output option")
    return plan


def _check_stdout(plan: Sequence[Mapping[str, Target]], *, json: bool) -> None:
    to_stdout = [(option, target) for targets in plan for option, target in targets.items() if target.is_stdout]
    if not to_stdout:
        return
    option = to_stdout[0][0]
    if json:
        raise UsageError(f"--{option} -: standard output is taken by --json; accepted is one of the two")
    if len(to_stdout) > 1:
        raise UsageError(f"--{option} -: {len(to_stdout)} results for standard output; accepted is one")
    if sys.stdout.isatty() and to_stdout[0][1].ending not in (".svg", ".dxf", ".geojson", ".csv"):
        raise UsageError(f"--{option} -: standard output is a terminal; accepted is a pipe or a file")


def _check_distinct(plan: Sequence[Mapping[str, Target]], inputs: Sequence[Input]) -> None:
    sources = {os.path.realpath(item.path) for item in inputs if not item.is_stdin}
    seen: dict[str, str] = {}
    for targets in plan:
        for option, target in targets.items():
            if target.is_stdout or (os.path.exists(target.name) and _is_device(target.name)):
                continue
            place = os.path.realpath(target.name)
            if place in sources:
                raise UsageError(f"--{option} {target.name}: is an input; accepted is another name")
            if place in seen:
                accepted = (
                    "a name for each, such as 'out/{stem}.png' or 'out/{folder}-{stem}.png'"
                    if len(inputs) > 1
                    else "different names"
                )
                raise UsageError(
                    f"--{option} {target.name}: named twice (also by --{seen[place]}); accepted is {accepted}"
                )
            seen[place] = option


def _check_writable(target: Target) -> None:
    final = Path(os.path.realpath(target.name))
    try:
        mode = final.stat().st_mode
    except FileNotFoundError:
        mode = None
    except OSError as error:
        raise UsageError(f"{target.name}: {error.strerror}; accepted is a file name in a folder") from None
    if mode is not None and stat.S_ISDIR(mode):
        raise UsageError(f"{target.name}: is a folder; accepted is a file name")
    if mode is not None and not stat.S_ISREG(mode):
        return
    if mode is not None and not target.force:
        raise UsageError(f"{target.name}: exists; accepted is another name, or --force to replace it")
    if not final.parent.is_dir():
        raise UsageError(f"{target.name}: there is no folder {final.parent}; accepted is an existing folder")
    if not os.access(final.parent, os.W_OK | os.X_OK):
        raise UsageError(f"{target.name}: the folder {final.parent} cannot be written to; accepted is one that can")


def _is_device(name: str) -> bool:
    mode = os.stat(name).st_mode
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))
