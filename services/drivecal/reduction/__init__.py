"""Scenario simulation reduction (Section III of the paper): which stored result may answer a cell. Pure.

>>> from decimal import Decimal
>>> from drivecal.domain.influence import Influence, InfluenceMap
>>> from drivecal.domain.parameters import ParameterSet
>>> from drivecal.reduction import Policy, ReferenceKeys, RequestedCell, assign, billionths_matrix
>>> influence_map = InfluenceMap({"S1": {"colour": Influence(influential=False)}})
>>> red, blue = (ParameterSet.of({"speed": Decimal(30), "colour": Decimal(value)}) for value in (1, 2))
>>> keys = ReferenceKeys(influence_map, "S1", red.names).keys(billionths_matrix([red, blue]))
>>> cells = [RequestedCell(number, "S1", each, keys[number]) for number, each in enumerate([red, blue])]
>>> [str(cell.plan) for cell in assign(cells, Policy("influence"), exact={}, references={})]
['simulated', 'reused']
"""

from drivecal.domain.evaluations import RequestedCell
from drivecal.reduction.assignment import Policy, assign
from drivecal.reduction.audit import clopper_pearson, error_rates, is_audited, is_checked
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.reduction.narrowing import SearchArea, common_area, full_area

__all__ = [
    "Policy",
    "ReferenceKeys",
    "RequestedCell",
    "SearchArea",
    "assign",
    "billionths_matrix",
    "clopper_pearson",
    "common_area",
    "error_rates",
    "full_area",
    "is_audited",
    "is_checked",
]
