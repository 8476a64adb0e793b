"""Speed functions: what every application says and every solver reads."""

from tspline.speed.basic import AdvectionSpeed, ConstantSpeed, CurvatureSpeed, SumSpeed
from tspline.speed.principal import FilletSpeed, GaussCurvatureSpeed, PrincipalCurvatureSpeed
from tspline.speed.problem import Problem, StoppingRule
from tspline.speed.samples import LevelSetSamples, LevelSetState
from tspline.speed.terms import Speed, SpeedTerms

__all__ = [
    "AdvectionSpeed",
    "ConstantSpeed",
    "CurvatureSpeed",
    "FilletSpeed",
    "GaussCurvatureSpeed",
    "LevelSetSamples",
    "LevelSetState",
    "PrincipalCurvatureSpeed",
    "Problem",
    "Speed",
    "SpeedTerms",
    "StoppingRule",
    "SumSpeed",
]
