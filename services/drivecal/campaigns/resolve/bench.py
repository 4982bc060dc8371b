"""The bench of a campaign: everything except the parameter set that decides its results."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite, nan
from typing import Any

from drivecal.analysis.scoring import rate
from drivecal.bundles.expressions import Formula
from drivecal.bundles.fingerprints import evaluator_rating, score_id, setup_document
from drivecal.bundles.installed import Bundle
from drivecal.bundles.manifest import Manifest, ScoreEntry
from drivecal.contracts.work import CellResult, SetupRequest, runs_in_worker
from drivecal.domain.errors import describe
from drivecal.domain.evaluations import Rating
from drivecal.domain.parameters import Parameter
from drivecal.domain.scales import Scale
from drivecal.domain.setups import Setup, base_of
from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins import registry
from drivecal.plugins.ports import Evaluator, SeriesEvaluator

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Bench:
    """Scenarios of a problem with their simulator, and one of its scores."""

    bundle: Bundle
    score: str
    """Name of the score in the manifest."""
    function: str
    """Name of the function under test, for which influence maps hold: the problem, or the driving function of its planner."""
    parameters: tuple[Parameter, ...]
    """All parameters with their usual ranges, in the function's order."""
    scenarios: Mapping[str, Mapping[str, Any]]
    """Data of the scenarios by id, in order."""
    section: Mapping[str, Any]
    """The simulator's section, with the plug-ins that the campaign chose."""
    varied: tuple[VehicleParameter, ...] = ()
    """Side conditions that robustness studies vary."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Values of the side conditions."""
    vehicles: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """The same by scenario, where a variant has others."""
    evaluator: Evaluator | None = None
    """Rates the runs; None: the score has a formula."""
    seed: int = 1
    """Seed of all runs."""
    repeat: float = 0.0
    """Share of simulated cells that run twice on a simulator that does not claim to be deterministic."""
    earlier: Manifest | None = None
    """An earlier version of the manifest, whose parameters the setups name."""

    def __post_init__(self) -> None:
        """Raises UnavailableError if a plug-in lacks a shipped file, which reading its version reveals."""
        self.evaluator_id, self.setups  # noqa: B018  reading is what may fail

    @cached_property
    def setups(self) -> dict[str, Setup]:
        """Setups by scenario."""
        return self.setups_under(self.seed if self.has_seed else None)

    def setups_under(self, seed: int | None) -> dict[str, Setup]:
        """Returns the setups under a seed, None for none, by scenario."""
        manifest, files, tools = self.earlier or self.bundle.manifest, self.bundle.files, self.bundle.tools
        settings: dict[str, Any] = {"section": self.section, "tools": tools, "seed": seed}
        return {
            name: Setup(base, setup_document(manifest, base, files, data=data, varied=varied, **settings))
            for name, data in self.scenarios.items()
            for base, varied in [(base_of(name), self.vehicles.get(name, self.values))]
        }

    @property
    def fingerprints(self) -> frozenset[str]:
        """Fingerprints of the setups."""
        return frozenset(setup.fingerprint for setup in self.setups.values())

    @property
    def is_random(self) -> bool:
        """True if the manifest says that runs depend on a seed."""
        return self.bundle.manifest.simulator.random

    @property
    def has_seed(self) -> bool:
        """False if setups and stored cells are to have no seed: under the first seed of a simulator that is not random."""
        return self.is_random or self.seed > 1

    def seeded(self, seed: int) -> "Bench":
        """Returns the bench with another seed."""
        return self if seed == self.seed else replace(self, seed=seed)

    def seed_of(self, place: int) -> int:
        """Returns the seed of a part of a study by its place: 1, 2, and so on; always 1 if the simulator is not random."""
        return place + 1 if self.is_random else 1

    @cached_property
    def requests(self) -> dict[str, SetupRequest]:
        """Run requests to workers by scenario."""
        manifest, rater = self.bundle.manifest, self.evaluator
        # Each run of a child process is told its side conditions, as it is told its seed.
        is_told = bool(self.values or self.vehicles) and not runs_in_worker(self.section)
        served = replace(self, values={}, vehicles={}) if is_told else self
        sessions = served.setups_under(None) if self.has_seed or is_told else {}
        return {
            name: SetupRequest(
                bundle=self.bundle.digest,
                problem=manifest.problem,
                scenario=base_of(name),
                data=data,
                simulator=self.section,
                parameters=tuple(parameter.name for parameter in self.parameters),
                integers=manifest.integers,
                shapes={name: shape.document for name, shape in manifest.shapes.items()},
                measures=tuple(manifest.reported),
                failures=manifest.failures,
                series=tuple(manifest.series),
                run_fingerprint=self.setups[name].fingerprint,
                document=self.setups[name].document,
                tools=self.bundle.tools,
                varied=self.vehicles.get(name, self.values),
                evaluator=f"{rater.name} {rater.version}" if isinstance(rater, SeriesEvaluator) else None,
                seed=self.seed,
                session=sessions[name].fingerprint if sessions else "",
                resources=manifest.resources(base_of(name)),
                renews=manifest.simulator.renews,
            )
            for name, data in self.scenarios.items()
        }

    @property
    def to_probe(self) -> SetupRequest | None:
        """The first scenario's request if a worker has to report tools and inputs first: its answer is part of every setup."""
        if not self.bundle.manifest.simulator.asks_workers or self.bundle.tools is not None:
            return None
        return next(iter(self.requests.values()))

    @cached_property
    def evaluator_id(self) -> str:
        """Identifies the score: with the run fingerprint it names a rating."""
        if self.evaluator is not None:
            return evaluator_rating(self.evaluator, self._entry)
        return score_id(self.score, self._entry)

    @cached_property
    def scale(self) -> Scale:
        """Scale of the scores."""
        return self._entry.scale(self.score)

    @property
    def needs_series(self) -> bool:
        """True if the score needs the time series of runs, which workers alone have: they rate. Stored runs lack them."""
        return isinstance(self.evaluator, SeriesEvaluator)

    @property
    def repeated_share(self) -> float:
        """Share of simulated cells that run twice."""
        return 0.0 if self.bundle.manifest.simulator.deterministic else self.repeat

    def rate_result(self, scenario: str, result: CellResult) -> Rating | None:
        """Rates what a worker reports of a run: as `rate`, except if the worker has rated it by its time series."""
        if result.rating is None or result.score is None:
            return self.rate(scenario, result.metrics, result.failure)
        failed = result.failure is not None
        return Rating(self.scale.worth(result.rating, failed=failed), self.scale.worth(result.score, failed=failed))

    def rate(self, scenario: str, measures: Mapping[str, float | None], failure: str | None) -> Rating | None:
        """Rates a run by what is stored of it.

        Args:
            scenario: id of the run's scenario.
            measures: measures of the run; None for values that were not finite.
            failure: name of the failure that ended the run.

        Returns:
            the rating; None if the run lacks a measure that the score needs.
        """
        if self.evaluator is None:
            known = {name: value for name, value in measures.items() if value is not None}
            return rate(self._formula, self.scale, known, failure)
        scale = self.scale
        if failure is not None:
            return Rating(scale.failed, scale.failed)
        try:
            values = {name: nan if value is None else value for name, value in measures.items()}
            rating = self.evaluator.rate(self._rated_as(scenario), values)
        except (KeyError, ValueError):  # a measure that was not reported then, or not finite
            return None
        except Exception as error:  # noqa: BLE001  # a plug-in may raise any exception
            log.warning("the evaluator %s cannot rate a run of %s: %s", self.evaluator.name, scenario, describe(error))
            return None
        return Rating(scale.worth(rating.rating), scale.worth(rating.score)) if isfinite(rating.rating) else None

    def _rated_as(self, scenario: str) -> str:
        """Returns the class of a scenario for evaluators: its `rated_as`, or its id."""
        data = self.scenarios[scenario]
        if "catalogue" in data and self.bundle.manifest.has_planner:
            return registry.catalogue(data["catalogue"]).scenarios[base_of(scenario)].rated_as
        return str(data.get("rated_as", base_of(scenario)))

    @property
    def _entry(self) -> ScoreEntry:
        return self.bundle.manifest.scores[self.score]

    @cached_property
    def _formula(self) -> Formula:
        return Formula(self._entry.formula or "")
