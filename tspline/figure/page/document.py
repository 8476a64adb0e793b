"""The page around the pictures: one file that loads nothing, in light and dark."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template

__all__ = ["Document"]

_HERE = files("tspline.figure.page")
_SECTIONS = "<!-- sections -->"


@dataclass(frozen=True)
class Document:
    """A page in two pieces, between which sections are written one after the other.

    Attributes
    ----------
    title : str
        Plain text.
    head : str
        HTML below the title.
    foot : str
        HTML below the sections.
    """

    title: str
    head: str
    foot: str

    def pieces(self) -> tuple[str, str]:
        """What comes before and after the sections."""
        text = Template(_read("page.html")).substitute(
            title=escape(self.title), style=_read("page.css"), script=_read("page.js"), head=self.head, foot=self.foot
        )
        before, _, after = text.partition(_SECTIONS)
        return before, after

    def html(self, sections: Iterable[str]) -> str:
        """The whole page."""
        before, after = self.pieces()
        return before + "".join(sections) + after


def _read(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")
