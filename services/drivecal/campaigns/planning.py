"""Looks up what is stored for the cells of a population and plans how each is answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection

from drivecal.campaigns.problem import Bench
from drivecal.domain.campaigns import Stage
from drivecal.domain.evaluations import Donor
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.assignment import Policy, RequestedCell, assign
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.storage import evaluations, parameter_sets, reference_keys, runs, setups
from drivecal.storage.database import Database
from drivecal.storage.evaluations import NewEvaluation


@dataclass(frozen=True)
class View:
    """What one campaign sees of the database: its own cells, and the runs up to its watermark."""

    campaign: int
    """Its sequence."""
    watermark: int
    bench: Bench
    influence_map: InfluenceMap | None = None
    influence_map_sequence: int | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The driving function's parameters, in its order."""
        return tuple(parameter.name for parameter in next(iter(self.bench.driving_function.spaces.values())))

    @cached_property
    def keys(self) -> dict[str, ReferenceKeys]:
        """How reference keys are computed, by scenario; empty without an influence map."""
        if self.influence_map is None:
            return {}
        return {scenario: ReferenceKeys(self.influence_map, scenario, self.names) for scenario in self.bench.scenarios}


def ensure_setups(connection: Connection, bench: Bench) -> dict[str, int]:
    """The database's id of each scenario's setup."""
    return dict(zip(bench.setups, setups.ensure(connection, list(bench.setups.values())), strict=True))


def sync_reference_keys(database: Database, view: View) -> None:
    """Gives every stored run that the campaign sees its key under the campaign's influence map: in bulk, once, resumable."""
    if view.influence_map_sequence is None:
        return
    with database.transaction() as connection:
        setup_ids = ensure_setups(connection, view.bench)
    for scenario, setup_id in setup_ids.items():
        reference_keys.sync(database, view.influence_map_sequence, setup_id, view.watermark, partial(_keys_of, view, scenario))


def _keys_of(view: View, scenario: str, names: tuple[str, ...], values: npt.NDArray[np.int64]) -> list[bytes]:
    return ReferenceKeys(view.influence_map or InfluenceMap({}), scenario, names).keys(values)


def plan_population(
    connection: Connection,
    view: View,
    policy: Policy,
    stage: Stage,
    iteration: int,
    individuals: Sequence[tuple[int, ParameterSet]],
) -> list[NewEvaluation]:
    """The requested cells of a population, individual by individual, each in every scenario, with what answers them."""
    set_ids = parameter_sets.ensure(connection, [one for _, one in individuals])
    set_keys = [one.key for _, one in individuals]
    setup_ids = ensure_setups(connection, view.bench)
    class_keys = _class_keys(view, [one for _, one in individuals])
    exact: dict[tuple[str, bytes], Donor] = {}
    references: dict[tuple[str, bytes], Donor] = {}
    if policy.mode != "off":
        for scenario, setup_id in setup_ids.items():
            by_set = dict(zip(set_ids, set_keys, strict=True))
            known = _exact(connection, view, scenario, setup_id, list(by_set))
            exact |= {(scenario, by_set[set_id]): donor for set_id, donor in known.items()}
            if scenario in class_keys and policy.mode == "influence":
                wanted = list(dict.fromkeys(class_keys[scenario]))
                found = _references(connection, view, scenario, setup_id, wanted)
                references |= {(scenario, key): donor for key, donor in found.items()}
    cells: list[RequestedCell] = []
    new: list[tuple[int, str]] = []
    for position, (individual, _) in enumerate(individuals):
        for scenario in setup_ids:
            key = class_keys[scenario][position] if scenario in class_keys else None
            cells.append(RequestedCell(individual, scenario, set_keys[position], key))
            new.append((set_ids[position], scenario))
    return [
        NewEvaluation(
            stage=stage,
            iteration=iteration,
            individual=cell.individual,
            scenario=scenario,
            setup_id=setup_ids[scenario],
            parameter_set_id=set_id,
            plan=assignment.plan,
            reference_key=cell.reference_key,
            donor=assignment.donor,
            leader=assignment.leader,
            audited=assignment.audited,
        )
        for cell, (set_id, scenario), assignment in zip(cells, new, assign(cells, policy, exact, references), strict=True)
    ]


def _class_keys(view: View, sets: Sequence[ParameterSet]) -> dict[str, list[bytes]]:
    values = billionths_matrix(sets)
    return {scenario: keys.keys(values) for scenario, keys in view.keys.items()} if sets else {}


def _exact(connection: Connection, view: View, scenario: str, setup_id: int, set_ids: Sequence[int]) -> dict[int, Donor]:
    """Results of earlier campaigns come first in the order of references, then the campaign's own."""
    own = evaluations.own_exact(connection, view.campaign, scenario, set_ids)
    return own | runs.look_up_exact(connection, setup_id, set_ids, view.bench.evaluator_id, view.watermark)


def _references(connection: Connection, view: View, scenario: str, setup_id: int, keys: Sequence[bytes]) -> dict[bytes, Donor]:
    own = evaluations.own_references(connection, view.campaign, scenario, keys)
    if view.influence_map_sequence is None:
        return own
    return own | reference_keys.look_up(
        connection, view.influence_map_sequence, setup_id, keys, view.bench.evaluator_id, view.watermark
    )
