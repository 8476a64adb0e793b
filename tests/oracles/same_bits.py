"""Results on one thread and on two, twice."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys


def digests(script: str) -> set[str]:
    """The SHA-256 digests that a script prints, in processes of their own."""
    told = set()
    for threads in ("1", "2", "2"):
        run = subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "RAYON_NUM_THREADS": threads},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        told.add(run.stdout.strip())
    assert all(len(digest) == 2 * hashlib.sha256().digest_size for digest in told)
    return told
