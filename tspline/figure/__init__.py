"""Figures and animations of an evolution; Matplotlib is imported by the modules that draw."""

from tspline.figure.recorder import Recorder, Snapshot

__all__ = ["Recorder", "Snapshot"]
