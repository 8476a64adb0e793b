"""Batches: which files, in which order, on how many processes, and what happens when one of them dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import fake_process
import numpy as np
import pytest
from PIL import Image

from cli.arguments import UsageError
from cli.batch import DONE, FAILED, Job, run_batch
from cli.inputs import Input, expand
from cli.main import main
from cli.outputs import Target
from cli.reporter import Reporter
from cli.workers import in_processes, limit_threads, processors

REPOSITORY = Path(__file__).resolve().parent.parent
needs_signals = pytest.mark.skipif(os.name != "posix", reason="needs signals")


@pytest.fixture(autouse=True)
def _threads_as_before() -> Iterator[None]:
    """What `limit_threads` sets is taken back."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def disc(path: str, radius: float, bright: int = 200) -> None:
    row, col = np.indices((40, 48))
    Image.fromarray(np.where(np.hypot(row - 20, col - 24) < radius, bright, 40).astype(np.uint8)).save(path)


def job() -> Job:
    return Job(fake_process.process, Reporter("segment"))


def tasks(*names: str) -> list[tuple[Input, dict[str, Target]]]:
    return [(Input(name), {}) for name in names]


def test_a_folder_gives_its_files_sorted_and_hidden_ones_not(folder: Path) -> None:
    (folder / "in" / "b").mkdir(parents=True)
    (folder / "in" / ".cache").mkdir()
    for name in ("z.png", "A.PNG", "a.tif", "notes.txt", ".hidden.png", "b/y.png", "b/x.png", ".cache/c.png"):
        (folder / "in" / name).touch()
    endings = (".png", ".tif")
    assert [item.path for item in expand(["in"], endings)] == ["in/A.PNG", "in/a.tif", "in/z.png"]
    below = ["in/A.PNG", "in/a.tif", "in/z.png", "in/b/x.png", "in/b/y.png"]
    assert [item.path for item in expand(["in"], endings, recursive=True)] == below
    assert [item.path for item in expand(["in/b", "in/*.png", "other"], endings)] == [
        "in/b/x.png", "in/b/y.png", "in/z.png", "other",
    ]  # fmt: skip
    with pytest.raises(UsageError, match=r"in: found no file directly in it .*\.dcm"):
        expand(["in"], (".dcm",))
    with pytest.raises(UsageError, match="in a folder below"):
        expand(["in"], (".dcm",), recursive=True)


def test_threads_are_shared_among_workers_and_never_more_than_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "cv2", raising=False)
    monkeypatch.setattr(os, "environ", {})
    for asked, given in (("", "3"), ("2", "2"), ("8", "3"), ("0", "3"), ("many", "3")):
        os.environ["RAYON_NUM_THREADS"] = asked
        limit_threads(3)
        assert os.environ["RAYON_NUM_THREADS"] == given
        assert os.environ["OPENBLAS_NUM_THREADS"] == "3"


@needs_signals
def test_a_killed_worker_fails_its_own_input_and_the_order_stays(folder: Path) -> None:
    outcomes = list(in_processes(job(), tasks("slow", "kill", "a", "fail", "b"), jobs=2))
    assert [outcome.status for outcome in outcomes] == [DONE, FAILED, DONE, FAILED, DONE]
    assert outcomes[0].summary == "slow: fine"
    assert "kill: the worker process was killed (signal 9" in outcomes[1].message
    assert outcomes[3].message.startswith("somewhere: Input/output error")
    assert outcomes[4].summary == "b: fine"
    assert len({outcome.values["pid"] for outcome in outcomes if outcome.status == DONE}) == 2
    assert os.getpid() not in {outcome.values.get("pid") for outcome in outcomes}


def test_messages_come_in_the_order_of_the_inputs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ["slow1", "b", "slow2", "d"]
    plan = [{"mask": Target(f"{name}.txt", ".txt", False)} for name in names]
    reporter = Reporter("segment")
    runner = partial(in_processes, jobs=2)
    assert run_batch([*map(Input, names)], plan, fake_process.process, reporter, keys=(), runner=runner) == DONE
    said = capsys.readouterr()
    lines = said.out.splitlines()
    assert [line.split(":")[0] for line in lines[:-1:2]] == names
    assert lines[-1] == "4 inputs: 4 done"
    assert said.err.splitlines() == [f"tspline segment: warning: {name}: warned of {name}" for name in names]
    share = str(min(max(1, processors() // 2), int(os.environ["RAYON_NUM_THREADS"] or 99)))
    assert Path("b.txt").read_text() == f"b {share}"


@needs_signals
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_all_workers_and_leaves_no_file(folder: Path, number: int) -> None:
    code = (
        "import signal, sys, fake_process, cli.main\n"
        "from cli.batch import run_batch\n"
        "from cli.inputs import Input\n"
        "from cli.outputs import Target\n"
        "from cli.reporter import Reporter\n"
        "from cli.workers import in_processes\n"
        "from functools import partial\n"
        # A shell's background job inherits that SIGINT is ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def dispatch(command, words):\n"
        "    names = ['forever', 'a', 'forever', 'forever']\n"
        "    plan = [{'mask': Target(f'{k}.txt', '.txt', False)} for k in range(4)]\n"
        "    run_batch([*map(Input, names)], plan, fake_process.process, Reporter('segment'), keys=(),\n"
        "              runner=partial(in_processes, jobs=3))\n"
        "cli.main._dispatch = dispatch\n"
        "sys.exit(cli.main.main(['segment']))\n"
    )
    path = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests")])
    running = subprocess.Popen(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": path}, stderr=subprocess.PIPE, text=True,
        stdout=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    until = time.monotonic() + 60
    while not any(folder.glob("begun-*")) and running.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    # Ctrl-C reaches the whole group, a request to terminate the command alone
    if number == signal.SIGINT:
        os.killpg(running.pid, number)
    else:
        running.send_signal(number)
    _, said = running.communicate(timeout=60)
    assert running.returncode == (130 if number == signal.SIGINT else 128 + number), said
    assert "Traceback" not in said
    begun = [path.name for path in folder.glob("begun-*")]
    assert begun
    for name in begun:
        with pytest.raises(ProcessLookupError):
            os.kill(int(name.removeprefix("begun-")), 0)
    assert {path.name for path in folder.iterdir()} <= {*begun, "1.txt"}


def test_jobs_give_the_same_files_as_one_process(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The real thing, on small images, one of them damaged."""
    (folder / "in").mkdir()
    for number, radius in enumerate((9.0, 11.5, 13.2)):
        disc(f"in/{number}.png", radius)
    (folder / "in" / "bad.png").write_bytes(b"no image")
    records, errors = {}, {}
    for out, words in (("one", []), ("two", ["--jobs", "2"])):
        (folder / out).mkdir()
        asked = ["--mask", "m.png", "--contour", "c.svg", "--model", "s.tsp.npz", "--report", "r.html", "--objects",
                 "o.csv"]  # fmt: skip
        named = [
            word if word.startswith("--") else f"{out}/{word}" if word[0] in "ro" else f"{out}/{{stem}}-{word}"
            for word in asked
        ]
        assert main(["segment", "in", *named, *words, "--json"]) == 2
        said = capsys.readouterr()
        records[out] = [json.loads(line) for line in said.out.splitlines()]
        errors[out] = said.err
    assert [record["input"] for record in records["two"]] == ["in/0.png", "in/1.png", "in/2.png", "in/bad.png"]
    assert errors["one"] == errors["two"]
    files = {path.name: path.read_bytes() for path in (folder / "one").iterdir()}
    assert len(files) == 3 * 3 + 2
    assert files == {path.name: path.read_bytes() for path in (folder / "two").iterdir()}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("segment - a.png --jobs 2", "standard input cannot be read by other processes (--jobs)"),
        ("segment a.png --jobs two", "accepted is a number of processes"),
        ("segment a.png --jobs 2 --scheduler h:1", "not allowed with argument"),
        ("segment - --scheduler h:1", "(--scheduler)"),
        ("segment a.png --mask {folder}{x}.png", "found {x}; accepted is {stem} or {folder}"),
        ("segment a.png --table {stem}.csv", "is one file for all inputs"),
        ("segment a.png --table t.txt", "the ending '.txt'; accepted is .csv"),
        ("segment a.png --table t.csv --objects t.csv", "named twice"),
        ("segment a.png --report r.html --mask r.html", "accepted is .png"),
        ("segment a.png --table - --objects -", "2 results"),
        ("segment a.png --table - --json", "taken by --json"),
        ("segment a.png --report no/r.html", "there is no folder"),
    ],
)
def test_wrong_usage(folder: Path, capsys: pytest.CaptureFixture[str], words: str, told: str) -> None:
    disc("a.png", 9.0)
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert told in line
    assert [path.name for path in folder.iterdir()] == ["a.png"]


def test_equal_names_in_folders_are_told_apart_by_the_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (folder / "in" / name).mkdir(parents=True)
        disc(f"in/{name}/1.png", 10.0)
    assert main(["segment", "in", "--recursive", "--mask", "{stem}.png"]) == 2
    assert "'out/{folder}-{stem}.png'" in capsys.readouterr().err
    assert main(["segment", "in", "--recursive", "--mask", "{folder}-{stem}.png"]) == 0
    assert {path.name for path in folder.iterdir()} == {"in", "a-1.png", "b-1.png"}
