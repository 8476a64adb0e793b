"""Self-contained pages: pictures with level sets over them as lines that stay sharp at any size."""

from tspline.figure.page.document import Document
from tspline.figure.page.plate import Frame, Plate

__all__ = ["Document", "Frame", "Plate"]
