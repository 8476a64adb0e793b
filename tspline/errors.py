"""Errors of the toolkit: every one derives from `TSplineError`."""

from __future__ import annotations

__all__ = ["FileFormatError", "InvalidArgumentError", "TSplineError", "VanishedError", "require"]


class TSplineError(Exception):
    """Base of all errors raised on purpose by this toolkit."""


class InvalidArgumentError(TSplineError, ValueError):
    """An argument that cannot be used: its name, what was found and what would be accepted."""

    def __init__(self, name: str, found: str, accepted: str) -> None:
        self.name, self.found, self.accepted = name, found, accepted
        super().__init__(f"{name}: found {found}; accepted is {accepted}")


class FileFormatError(TSplineError, ValueError):
    """A file that cannot be read or written: its name, what is wrong and what would be accepted."""

    def __init__(self, path: object, wrong: str, accepted: str) -> None:
        self.path, self.wrong, self.accepted = str(path), wrong, accepted
        super().__init__(f"{path}: {wrong}; accepted is {accepted}")


class VanishedError(TSplineError):
    """The zero set vanished: nothing is left to evolve or to report."""


def require(condition: bool, name: str, found: object, accepted: str) -> None:
    """Raise `InvalidArgumentError` unless `condition` holds."""
    if not condition:
        raise InvalidArgumentError(name, str(found), accepted)
