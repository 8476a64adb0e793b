"""The command on bad usage and bad luck: one line, the right exit status, and no half-written file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fake_solver
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import recon
import segment
from cli.main import main
from tspline.errors import InvalidArgumentError, VanishedError

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    np.save("image.npy", np.random.default_rng(3).integers(0, 255, (20, 30), dtype=np.uint8))
    angle = np.linspace(0, 6.2, 40)
    np.savetxt("ring.xyz", np.column_stack([np.cos(angle), np.sin(angle)]))
    np.savetxt("space.xyz", np.random.default_rng(0).normal(size=(9, 3)))
    monkeypatch.setattr(segment, "segment_image", fake_solver.segment_image, raising=False)
    monkeypatch.setattr(recon, "fit_points", fake_solver.fit_points, raising=False)
    return tmp_path


def failed(capsys: pytest.CaptureFixture[str], *words: str, status: int = 2) -> str:
    """Run the command, which must end with `status` and one line on standard error."""
    assert main(list(words)) == status
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("tspline")
    assert "Traceback" not in line
    return line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("", "found no command"),
        ("frobnicate", "'frobnicate'; accepted is segment, fit, check, info, demo"),
        ("--frob", "--frob"),
        ("fit", "found no POINTS"),
        ("segment", "found no IMAGE"),
        ("info", "found no FILE"),
        ("fit ring.xyz --frob", "--frob"),
        ("fit ring.xyz --depth 0", "integer from 2 to 14"),
        ("fit ring.xyz --depth two", "'two'"),
        ("fit ring.xyz --tolerance -1", "above 0"),
        ("fit ring.xyz --gap nan", "above 0"),
        ("fit ring.xyz --init square", "'square'"),
        ("fit ring.xyz --mod a.npz", "--mod"),
        ("fit ring.xyz --quiet -v", "not allowed with"),
        ("segment image.npy --box 1,2,3", "r0,c0,r1,c1"),
        ("segment image.npy --box 9,9,1,1", "r0 < r1"),
        ("segment image.npy --box 1,1,9,9 --init a.png", "not allowed with"),
        ("segment image.npy --seeds 1,2,3", "accepted is r,c"),
        ("segment image.npy --seeds 1,2e,", "'1,2e,'; accepted is row,col"),
        ("segment image.npy --model-kind colours", "'colours'"),
        ("segment image.npy --init none.png --mask m.png", "none.png: No such file"),
        ("segment none.png", "none.png: No such file"),
        ("segment '*.bmp'", "no file matches"),
        ("segment folder.png", "folder.png: found no file directly in it"),
        ("segment ring.xyz", "ring.xyz: not an image"),
        ("fit none.xyz", "none.xyz: No such file"),
        ("fit image.npy", "image.npy: an array of type uint8 and shape (20, 30)"),
        ("fit ring.xyz --model a.txt", "the ending '.txt'; accepted is"),
        ("fit ring.xyz --figure a", "no ending"),
        ("fit ring.xyz --model none/a.npz", "there is no folder"),
        ("fit ring.xyz --model ring.xyz/a.npz", "Not a directory"),
        ("fit ring.xyz --contour {stam}.svg", "{stam}; accepted is {stem} or {folder}"),
        ("fit ring.xyz --figure taken.png", "taken.png: exists; accepted is another name, or --force"),
        ("fit ring.xyz --figure folder.png", "is a folder"),
        ("fit ring.xyz ring.xyz --model a.npz", "named twice"),
        ("fit ring.xyz space.xyz --model a.npz", "'out/{stem}.png'"),
        ("segment image.npy --mask image.npy --force", "is an input"),
        ("segment image.npy --mask m.png --figure ./m.png", "named twice"),
        ("fit ring.xyz --model - --json", "taken by --json"),
        ("fit ring.xyz --model - --figure -", "2 results"),
        ("fit ring.xyz space.xyz --model -", "2 results"),
        ("fit - -", "given twice"),
        ("info -", "accepted is a file"),
        ("info ring.doc", "the ending '.doc'"),
        ("demo --out ring.xyz", "ring.xyz"),
    ],
)
def test_wrong_usage_is_one_line_and_2(folder: Path, capsys: pytest.CaptureFixture[str], words: str, told: str) -> None:
    (folder / "taken.png").write_bytes(b"mine")
    (folder / "folder.png").mkdir()
    before = sorted(folder.rglob("*"))
    assert told in failed(capsys, *words.replace("'", "").split())
    assert sorted(folder.rglob("*")) == before
    assert (folder / "taken.png").read_bytes() == b"mine"


def test_outputs_are_checked_before_anything_runs(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recon, "fit_points", lambda *a, **o: pytest.fail("it ran"))
    (folder / "other.xyz").write_bytes((folder / "ring.xyz").read_bytes())
    (folder / "other.npz").write_bytes(b"mine")
    assert "other.npz" in failed(capsys, "fit", "ring.xyz", "other.xyz", "--model", "{stem}.npz")


def test_force_replaces(folder: Path) -> None:
    (folder / "a.png").write_bytes(b"old")
    assert main(["fit", "ring.xyz", "--figure", "a.png", "--force"]) == 0
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")


def test_dxf_without_its_package(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    assert "tspline[dxf]" in failed(capsys, "fit", "ring.xyz", "--contour", "a.dxf")


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (InvalidArgumentError("points", "2 points", "at least 3"), 2, "ring.xyz: points: found 2 points"),
        (VanishedError("the zero set vanished"), 1, "ring.xyz: the zero set vanished"),
        (MemoryError(), 1, "not enough memory"),
        (ZeroDivisionError("float\ndivision"), 1, "internal error, please report it: ZeroDivisionError"),
    ],
)
def test_errors_of_the_solver_are_one_line(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    status: int,
    told: str,
) -> None:
    def fail(points: object, **options: object) -> object:
        raise error

    monkeypatch.setattr(recon, "fit_points", fail)
    assert told in failed(capsys, "fit", "ring.xyz", "--model", "a.npz", status=status)
    assert not (folder / "a.npz").exists()


def test_interrupt_is_130_and_leaves_nothing_half_written(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(self: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(fake_solver.FakeSpline, "save", save)
    before = sorted(folder.iterdir())
    monkeypatch.setattr(recon, "fit_points", lambda p, callback=None, **o: _quiet(p))
    assert "interrupted" in failed(capsys, "fit", "ring.xyz", "--model", "a.npz", status=130)
    assert sorted(folder.iterdir()) == before


def _quiet(points: object) -> object:
    result = fake_solver.fit_points(points)
    result.warnings = []
    return result


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_full_disk_is_one_line_and_1(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recon, "fit_points", lambda p, **o: _quiet(p))
    line = failed(capsys, "fit", "ring.xyz", "--contour", "/dev/full", status=1)
    assert "/dev/full: No space left on device" in line


def test_disk_that_fills_up_leaves_the_old_file(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(self: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(fake_solver.FakeSpline, "save", save)
    monkeypatch.setattr(recon, "fit_points", lambda p, **o: _quiet(p))
    (folder / "a.npz").write_bytes(b"old")
    before = sorted(folder.iterdir())
    line = failed(capsys, "fit", "ring.xyz", "--model", "a.npz", "--force", status=1)
    assert "a.npz: No space left on device" in line
    assert (folder / "a.npz").read_bytes() == b"old"
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_process_cleanly(folder: Path, number: signal.Signals) -> None:
    code = (
        f"import signal, sys, time; sys.path.insert(0, {str(REPOSITORY / 'tests')!r})\n"
        "import fake_solver, recon\n"
        "from cli.main import main\n"
        # A shell's background job inherits that SIGINT is ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def slow(self, path):\n"
        "    path.write_bytes(b'half'); print('ready', flush=True); time.sleep(30)\n"
        "fake_solver.FakeSpline.save = slow\n"
        "recon.fit_points = fake_solver.fit_points\n"
        "sys.exit(main(['fit', 'ring.xyz', '--model', 'a.npz', '--quiet']))\n"
    )
    before = sorted(folder.iterdir())
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.1)
        process.send_signal(number)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == (130 if number == signal.SIGINT else 143)
    assert "Traceback" not in errors
    assert sorted(folder.iterdir()) == before


def test_a_reader_that_leaves_is_no_traceback(folder: Path) -> None:
    command = f"{sys.executable} -m cli.main info {' '.join(['ring.xyz'] * 300)} --json | head -n 1 >/dev/null"
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(command, shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


_COMMANDS = ["fit", "segment", "info", "ring.xyz", "image.npy", "-", "*", "--", "--help"]
_OPTIONS = ["--json", "--quiet", "-v", "--depth", "4", "--seeds", "1,2", "--box", "1,2,9,9", "--init", "auto"]
_OUTPUTS = ["--mask", "--model", "--figure", "x.png", "x.npz", "--contour", "c.svg", "{stem}"]
_WORDS = st.sampled_from([*_COMMANDS, *_OPTIONS, *_OUTPUTS])


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.one_of(_WORDS, st.text(max_size=6)), max_size=7))
def test_any_words_give_an_exit_status(folder: Path, words: list[str]) -> None:
    os.chdir(folder)
    with open(os.devnull) as nothing, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", nothing)
        assert main(words) in (0, 1, 2, 3)
