"""Speed functions: what every application says and every solver reads."""

from tspline.speed.basic import AdvectionSpeed, ConstantSpeed, CurvatureSpeed, SumSpeed
from tspline.speed.problem import Problem, StoppingRule
from tspline.speed.samples import LevelSetSamples, LevelSetState
from tspline.speed.terms import Speed, SpeedTerms

__all__ = [
    "AdvectionSpeed",
    "ConstantSpeed",
    "CurvatureSpeed",
    "LevelSetSamples",
    "LevelSetState",
    "Problem",
    "Speed",
    "SpeedTerms",
    "StoppingRule",
    "SumSpeed",
]
