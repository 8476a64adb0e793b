"""Every file complete or absent: written beside its final name, flushed to the disk, then renamed."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["complete_or_absent"]


@contextmanager
def complete_or_absent(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Give a temporary name to write to; rename it to `path` when the block ends without an error.

    The temporary file lies beside `path`, so that renaming is atomic, and keeps its endings, by which
    writers choose their format. After an error (Ctrl-C too) it is removed and `path` is as it was.

    Parameters
    ----------
    path : path
        Final name. A symbolic link is followed. A device or pipe (``/dev/null``) is written to directly,
        from a temporary file elsewhere.
    force : bool
        Replace an existing file; otherwise an existing `path` raises ``FileExistsError``, also when it
        appeared while the block ran.

    Yields
    ------
    pathlib.Path
        An empty file of a new name in the same folder.

    Raises
    ------
    FileExistsError, FileNotFoundError, IsADirectoryError, PermissionError, OSError
        With the final name in ``filename``, never the temporary one.
    """
    final = Path(os.path.realpath(path))
    mode = _mode_of(final)
    device = mode is not None and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))
    _check(mode, str(path), may_exist=force or device)
    folder = Path(tempfile.gettempdir()) if device else final.parent
    # Known before the file is there: Ctrl-C may come at any instant, and nothing may stay behind.
    temporary = _unguessable(folder, final.name)
    try:
        _create(temporary, mode if not device else None)
        yield temporary
        _flush(temporary)
        if device:
            with temporary.open("rb") as source, final.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            _rename(temporary, final, force=force)
            _flush_folder(folder)
    except OSError as error:
        if error.filename in (None, str(temporary)):
            # OSError itself picks the subclass that belongs to the number
            raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error
        raise
    finally:
        with suppress(OSError):
            temporary.unlink()


def _mode_of(path: Path) -> int | None:
    """File mode of `path`, None where nothing is there."""
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return None


def _check(mode: int | None, name: str, *, may_exist: bool) -> None:
    """Refuse folders, and files that may not be replaced."""
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder", name)
    if mode is not None and not may_exist:
        raise FileExistsError(errno.EEXIST, "exists", name)


def _unguessable(folder: Path, name: str) -> Path:
    """A new name in `folder` with the endings of `name`."""
    head, dot, endings = name.lstrip(".").partition(".")
    # Names are cut so that the temporary one stays below the usual limit of 255 bytes.
    return folder / f".{head[:40]}-{secrets.token_hex(6)}{dot}{endings[-100:]}"


def _create(temporary: Path, mode: int | None) -> None:
    """Create an empty file; `mode` is that of the file to be replaced."""
    handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    try:
        if mode is not None and hasattr(os, "fchmod"):
            with suppress(OSError):
                os.fchmod(handle, stat.S_IMODE(mode))
    finally:
        os.close(handle)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _flush_folder(folder: Path) -> None:
    """Make the rename itself durable; folders cannot be flushed on every system."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _rename(temporary: Path, final: Path, *, force: bool) -> None:
    """Give `temporary` its final name; without `force` never over a file, even one made meanwhile."""
    if force:
        os.replace(temporary, final)
        return
    try:
        os.link(temporary, final)
    except FileExistsError:
        raise FileExistsError(errno.EEXIST, "exists", str(final)) from None
    except OSError:  # the file system has no hard links
        if final.exists():
            raise FileExistsError(errno.EEXIST, "exists", str(final)) from None
        os.replace(temporary, final)
