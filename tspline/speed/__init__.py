"""Speed functions: what every application says and every solver reads."""

from tspline.speed.attraction import AttractionSpeed
from tspline.speed.basic import AdvectionSpeed, ConstantSpeed, CurvatureSpeed, SumSpeed
from tspline.speed.principal import FilletSpeed, GaussCurvatureSpeed, PrincipalCurvatureSpeed
from tspline.speed.problem import Problem
from tspline.speed.robust import robust_scale, robust_weights
from tspline.speed.samples import LevelSetSamples, LevelSetState
from tspline.speed.stopping import MESSAGES, StoppingRule
from tspline.speed.terms import Speed, SpeedTerms

__all__ = [
    "MESSAGES",
    "AdvectionSpeed",
    "AttractionSpeed",
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
    "robust_scale",
    "robust_weights",
]
