"""Agreement of two level sets: how far apart they are, and where."""

from tspline.agreement.agreement import Agreement
from tspline.agreement.cross_check import cross_check
from tspline.agreement.outline import Outline

__all__ = ["Agreement", "Outline", "cross_check"]
