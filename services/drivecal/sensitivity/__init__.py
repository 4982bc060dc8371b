"""Sensitivity analysis, pure: radial designs on the grid, elementary effects, complexity reduction, as ask/tell in phases.

>>> from decimal import Decimal
>>> from drivecal.domain.parameters import Parameter, ParameterSpace
>>> from drivecal.sensitivity import SensitivityAnalysis, SensitivitySettings
>>> grid = [Parameter.from_step(name, Decimal(0), Decimal(10), Decimal("0.1")) for name in ("speed", "colour")]
>>> settings = SensitivitySettings(design="lines", intervals=5, samples=10, threshold="auto", seed=1)
>>> analysis = SensitivityAnalysis(ParameterSpace(tuple(grid)), ["S1"], settings)
>>> while phase := analysis.ask():
...     analysis.tell({name: (points[:, 0] // 15).astype(float) for name, points in phase.points.items()})
>>> {name: parameter.influence.influential for name, parameter in analysis.result()["S1"].parameters.items()}
{'speed': True, 'colour': False}
"""

from drivecal.sensitivity.analysis import Phase, SensitivityAnalysis
from drivecal.sensitivity.scenario import ParameterInfluence, ScenarioInfluence
from drivecal.sensitivity.thresholds import MuSigmaThresholds, SensitivitySettings, Threshold

__all__ = [
    "MuSigmaThresholds",
    "ParameterInfluence",
    "Phase",
    "ScenarioInfluence",
    "SensitivityAnalysis",
    "SensitivitySettings",
    "Threshold",
]
