"""The same batch on a Dask cluster: results come back, and what goes wrong is told in a line."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import cli.cluster
from cli.main import main

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("default")  # Dask's own


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A cluster of one worker with two threads in this process, reached by TCP as a far one is."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RAYON_NUM_THREADS", "2")
    row, col = np.indices((40, 48))
    (tmp_path / "in").mkdir()
    for number, radius in enumerate((9.0, 12.0)):
        disc = np.where(np.hypot(row - 20, col - 24) < radius, 200, 40).astype(np.uint8)
        Image.fromarray(disc).save(f"in/{number}.png")
    Path("in/bad.png").write_bytes(b"no image")
    return tmp_path


def test_a_cluster_gives_what_one_process_gives(
    folder: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {}
    for out, words in (("here", []), ("there", ["--scheduler", scheduler])):
        Path(out).mkdir()
        asked = ["--mask", f"{out}/{{stem}}.png", "--model", f"{out}/{{stem}}.npz", "--report", f"{out}/r.html"]
        assert main(["segment", "in", *asked, *words, "--json"]) == 2
        files[out] = {path.name: path.read_bytes() for path in Path(out).iterdir()}
        said = capsys.readouterr()
        records = [json.loads(line) for line in said.out.splitlines()]
        assert [record["input"] for record in records] == ["in/0.png", "in/1.png", "in/bad.png"]
        assert [record["status"] for record in records] == [0, 0, 2]
        assert all(record["seconds"] > 0 for record in records)
        assert "in/bad.png: not an image" in said.err
    assert len(files["here"]) == 5
    # the report quotes the message of the damaged image, which names the file as the worker sees it
    page = files["there"].pop("r.html").replace(str(folder).encode() + b"/", b"")
    assert page == files["here"].pop("r.html")
    assert files["here"] == files["there"]


def test_a_scheduler_by_its_file_and_files_that_exist(
    folder: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("scheduler.json").write_text(json.dumps({"address": scheduler, "type": "Scheduler"}))
    Path("in/bad.png").unlink()
    words = ["segment", "in", "--scheduler", "scheduler.json", "--mask", "{stem}.png"]
    assert main(words) == 0
    assert "in/0.png: 1 object" in capsys.readouterr().out
    before = Path("0.png").read_bytes()
    assert main(words) == 2
    assert "0.png: exists" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert Path("0.png").read_bytes() == before


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("localhost", "neither an address nor a file; accepted is host:port"),
        ("a:b:c", "neither an address nor a file"),
        ("none.json", "neither an address nor a file"),
        ("in/0.png", "not the file of a scheduler"),
        ("list.json", "not the file of a scheduler"),
        ("127.0.0.1:9", "no scheduler answers within 0.5 s; accepted is host:port"),
    ],
)
def test_wrong_addresses_are_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], address: str, told: str
) -> None:
    monkeypatch.setattr(cli.cluster, "CONNECT_SECONDS", 0.5)
    Path("list.json").write_text("[]")
    before = sorted(folder.rglob("*"))
    assert main(["segment", "in", "--mask", "{stem}.png", "--table", "t.csv", "--scheduler", address]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--scheduler {address}: {told}" in line
    assert sorted(folder.rglob("*")) == before


def test_without_the_package(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["segment", "in", "--mask", "{stem}.png", "--scheduler", "127.0.0.1:8786"]) == 2
    assert "pip install 'tspline[dask]'" in capsys.readouterr().err


def test_an_error_of_the_cluster_fails_the_input(
    folder: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as a worker that lacks the package: each input is told, none hangs."""

    def lacking(order: bytes) -> None:
        raise ModuleNotFoundError("No module named 'cli'")

    monkeypatch.setattr(cli.cluster, "_work", lacking)
    assert main(["segment", "in", "--mask", "{stem}.png", "--scheduler", scheduler]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    assert "in/0.png: the cluster could not run it: ModuleNotFoundError" in lines[0]
