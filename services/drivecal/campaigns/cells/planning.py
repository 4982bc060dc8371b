"""Looks up stored results for a population's cells and plans how each cell is answered."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from sqlalchemy import Connection

from drivecal.analysis.goals import CellValue
from drivecal.campaigns.cells.earlier import EarlierVersion, answers_of
from drivecal.campaigns.resolve.bench import Bench
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Donor, Purpose, RequestedCell
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.execution.measures import MEASURES
from drivecal.reduction.assignment import assign
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix, keys_under
from drivecal.storage import evaluations
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets, reference_keys, runs, setups


@dataclass(slots=True)
class ReuseTime:
    """CPU time of this thread for a campaign's reuse: look-ups, keys, lots, and what predictions take besides their models."""

    seconds: float = 0.0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Adds the time of the block."""
        began = time.thread_time()
        yield
        self.seconds += time.thread_time() - began


@dataclass(frozen=True)
class View:
    """A campaign's view of the database: its own cells, and the runs up to its watermark."""

    campaign: int
    """Number of the campaign."""
    watermark: int
    bench: Bench
    scores: Sequence[CellValue] = ()
    """Scores of objectives and constraints that cells do not store."""
    isolated: bool = False
    """Runs that others share with it count in its budget, so that its end does not depend on them."""
    influence_map: InfluenceMap | None = None
    influence_map_sequence: int = 0
    """Number of the influence map, if there is one."""
    traced: bool = False
    """The time series of its cells are wanted."""
    workers: int = 1
    """Workers at the beginning."""
    seed: int = 0
    """Seed of the search, which decides which reused cells are audits, and which cells run twice."""
    earlier: tuple[EarlierVersion, ...] = ()
    """Earlier versions of the problem whose runs answer cells: claims about them are checked."""
    reuse_time: ReuseTime = field(default_factory=ReuseTime)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, in the function's order."""
        return tuple(parameter.name for parameter in self.bench.parameters)

    @cached_property
    def keys(self) -> dict[str, ReferenceKeys]:
        """The reference key functions by scenario; empty without an influence map."""
        if self.influence_map is None:
            return {}
        return {scenario: ReferenceKeys(self.influence_map, scenario, self.names) for scenario in self.bench.scenarios}


def ensure_setups(connection: Connection, bench: Bench) -> dict[str, int]:
    """The database's id of each scenario's setup."""
    return dict(zip(bench.setups, setups.ensure(connection, list(bench.setups.values())), strict=True))


def sync_reference_keys(database: Database, view: View) -> None:
    """Stores the reference key of every visible run under the campaign's influence map: in bulk, once, resumable.

    The campaign's evaluator must have rated the runs before (`rerating`): unrated runs have no key.
    """
    if view.influence_map is None:
        return
    with database.transaction() as connection:
        setup_ids = ensure_setups(connection, view.bench)
    evaluator = view.bench.evaluator_id
    for scenario, setup_id in setup_ids.items():
        keys_of = partial(keys_under, view.influence_map, scenario)
        reference_keys.sync(database, view.influence_map_sequence, setup_id, evaluator, view.watermark, keys_of)


@MEASURES.lookup.time()
def plan_cells(
    connection: Connection,
    view: View,
    policy: ReductionSpecification,
    stage: StageName,
    iteration: int,
    wanted: Sequence[RequestedCell],
    before: int | None = None,
) -> list[RequestedCell]:
    """Returns the planned answer of each requested cell, in order. `before`: see `storage.evaluations.own_answers`."""
    setup_ids = ensure_setups(connection, view.bench)
    sets = list(dict.fromkeys(cell.parameters for cell in wanted))
    set_ids = dict(zip(sets, parameter_sets.ensure(connection, sets), strict=True))
    exact: dict[tuple[str, ParameterSet], Donor] = {}
    references: dict[tuple[str, bytes], Donor] = {}
    elsewhere: dict[tuple[str, ParameterSet], Donor] = {}
    class_keys: dict[tuple[str, ParameterSet], bytes] = {}
    stocked = runs.stocked(connection, setup_ids.values())  # nothing is known in other vehicles that were never driven
    with view.reuse_time.counted():
        for scenario, setup_id in setup_ids.items():
            here = list(dict.fromkeys(cell.parameters for cell in wanted if cell.scenario == scenario))
            if not here:
                continue
            if scenario in view.keys:
                keys = view.keys[scenario].keys(billionths_matrix(here))
                class_keys |= {(scenario, asked): key for asked, key in zip(here, keys, strict=True)}
            if policy.mode != "off" and setup_id in stocked:
                by_id = {set_ids[parameter_set]: parameter_set for parameter_set in here}
                asked, evaluator = list(by_id), view.bench.evaluator_id
                known = evaluations.own_answers(connection, view.campaign, scenario, setup_id, asked, before)
                # earlier campaigns' come first
                known |= runs.look_up_exact(connection, setup_id, asked, evaluator, view.watermark)
                exact |= {(scenario, by_id[set_id]): donor for set_id, donor in known.items()}
            if policy.uses_map and scenario in view.keys and setup_id in stocked:
                distinct = list(dict.fromkeys(keys))
                stored = evaluations.own_answers(connection, view.campaign, scenario, setup_id, distinct, before, by_key=True)
                stored |= reference_keys.look_up(
                    connection, view.influence_map_sequence, setup_id, distinct, view.bench.evaluator_id, view.watermark
                )
                references |= {(scenario, key): donor for key, donor in stored.items()}
                if not view.isolated:
                    place = view.campaign, iteration, scenario, setup_id
                    known = evaluations.released_before(connection, place, view.bench.evaluator_id, list(by_id))
                    elsewhere |= {(scenario, by_id[set_id]): donor for set_id, donor in known.items()}
        if policy.mode != "off" and view.earlier:
            open_cells = {(cell.scenario, cell.parameters): None for cell in wanted}.keys() - exact.keys()
            exact |= answers_of(connection, view.bench, view.earlier, open_cells, view.watermark)
    placed = [
        replace(
            cell,
            stage=stage,
            purpose=cell.purpose if stage is StageName.CALIBRATION else Purpose(stage),
            iteration=iteration,
            setup_id=setup_ids[cell.scenario],
            parameter_set_id=set_ids[cell.parameters],
            reference_key=class_keys.get((cell.scenario, cell.parameters)),
            seed=view.bench.seed,
            has_seed=view.bench.has_seed,
        )
        for cell in wanted
    ]
    return assign(placed, policy, view.seed, exact, references, elsewhere)
