"""Optuna's samplers as optimizers: `optimizer: {kind: optuna, sampler: tpe}`, with the extra [optuna]."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices, Kind
from drivecal.domain.rounding import Scaling
from drivecal.optimizers.built_in import ONE_OBJECTIVE, Beginning, BuiltIn
from drivecal.optimizers.repair import searchable
from drivecal.optimizers.replayed import Replayed, named, require, scaled, scalings_of, stop_if_abandoned
from drivecal.plugins.ports import Ability, DeclaringOptimizerPlugin, Floats

require("optuna", extra="optuna")

TIE = 1e-6
"""Weight of the rating, which is added to the objective: it orders equal objectives, and is less than a step of a score with few steps."""

VIOLATION = "violation"
"""Name of the constraint that holds the sum of all violations."""


class OptunaSettings(OptimizerSpecification):
    """`sampler`: Optuna's `TPESampler`, `NSGAIISampler` (with one objective a genetic algorithm) or `RandomSampler`.

    The tree-structured Parzen estimator gets slower with every trial; it is meant for hundreds, not for tens of thousands. With several
    objectives it proposes by the expected improvement of the hypervolume (Ozaki et al. 2022, J. Artif. Intell. Res. 73).
    """

    model_config = ConfigDict(extra="forbid")

    kind: Literal["optuna"] = "optuna"
    sampler: Literal["tpe", "nsga2", "random"] = "tpe"


class OptunaEngine:
    """A study in memory, asked for a whole population at a time.

    Grids and integers are integers of the study, continuous parameters are floats from 0 to 1, choices are categories. The study begins
    with the first answers, which tell the number of objectives.
    """

    def __init__(self, settings: OptunaSettings, n_values: Indices, kinds: Sequence[Kind]) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.library = named("optuna")
        self._population = settings.population
        self._last = searchable(n_values) - 1
        self._continuous = np.array([kind == "continuous" for kind in kinds])
        self._distributions: dict[str, Any] = {
            f"x{column}": _distribution(kind, last)
            for column, (kind, last) in enumerate(zip(kinds, self._last.tolist(), strict=True))
        }
        self._sampler = _sampler(settings)
        self._counts_generations = settings.sampler == "nsga2"
        self._study: Any = None
        self._scalings: list[Scaling] = []
        self._asked: list[Any] = []

    def propose(self) -> Indices:
        if self._counts_generations:
            self._sampler.number += 1
        self._asked = []
        for _ in range(self._population):  # minutes, with many
            stop_if_abandoned()
            self._asked.append(self._study.ask(self._distributions))
        rows = [[trial.params[name] for name in self._distributions] for trial in self._asked]
        return np.column_stack(
            [
                np.rint(np.array(column) * last).astype(np.int64) if is_float else np.array(column, dtype=np.int64)
                for column, last, is_float in zip(zip(*rows, strict=True), self._last, self._continuous, strict=True)
            ]
        )

    def learn(self, population: Indices, objectives: Floats, tie_breakers: Floats) -> None:
        """See `replayed.Engine`. Several objectives have violations in the place of tie breakers (`ports.Optimizer.tell`)."""
        import optuna

        is_vector = objectives.ndim == 2
        values = objectives if is_vector else (objectives + TIE * tie_breakers)[:, np.newaxis]
        self._scalings = self._scalings or scalings_of(values)
        values = scaled(values, self._scalings)
        missing = np.isnan(values).any(axis=1) | (is_vector & np.isnan(tie_breakers))
        answers = list(zip(values.tolist(), tie_breakers.tolist(), missing.tolist(), strict=True))
        failed, complete = optuna.trial.TrialState.FAIL, optuna.trial.TrialState.COMPLETE
        if self._study is None:  # the start population, which Optuna has not proposed
            self._study = optuna.create_study(directions=["maximize"] * values.shape[1], sampler=self._sampler)
            self._study.add_trials(
                optuna.trial.create_trial(
                    params=dict(zip(self._distributions, self._params(row), strict=True)),
                    distributions=self._distributions,
                    system_attrs=self._sampler.marks() if self._counts_generations else None,
                    constraints={VIOLATION: violation} if is_vector and not is_missing else None,
                    **({"state": failed} if is_missing else {"values": amounts}),
                )
                for row, (amounts, violation, is_missing) in zip(population.tolist(), answers, strict=True)
            )
            return
        for trial, (amounts, violation, is_missing) in zip(self._asked, answers, strict=True):
            if is_vector and not is_missing:
                trial.set_constraint(VIOLATION, violation)
            self._study.tell(trial, None if is_missing else amounts, state=failed if is_missing else complete)

    def _params(self, row: Sequence[int]) -> list[int | float]:
        """Returns the study's values for a row of grid indices."""
        listed = zip(row, self._last.tolist(), self._continuous, strict=True)
        return [index / last if is_float else index for index, last, is_float in listed]


def _distribution(kind: Kind, last: int) -> Any:
    from optuna import distributions

    match kind:
        case "continuous":
            return distributions.FloatDistribution(0.0, 1.0)
        case "choice":
            return distributions.CategoricalDistribution(range(last + 1))
        case _:
            return distributions.IntDistribution(0, last)


def _sampler(settings: OptunaSettings) -> Any:
    from optuna import samplers

    seed = settings.seed % 2**32  # as wide as Optuna's seeds are
    match settings.sampler:
        case "tpe":
            return samplers.TPESampler(seed=seed, multivariate=False, constant_liar=True)
        case "nsga2":
            return _generations()(seed=seed, population_size=settings.population)
        case "random":
            return samplers.RandomSampler(seed=seed)


def _generations() -> Any:
    """Returns the class of a sampler for which each population is a generation, and the start population the first.

    Optuna counts a generation by complete trials: a start population that it has not proposed is none, and a failed run repeats the whole
    generation.
    """
    from optuna import samplers

    class Generations(samplers.NSGAIISampler):
        number = 0
        """The generation that is asked for."""

        def marks(self) -> dict[str, int]:
            return {self._get_generation_key(): self.number}

        def get_trial_generation(self, study: Any, trial: Any) -> int:
            storage, number = study._storage, trial._trial_id  # noqa: SLF001  # there is no public way
            for key, generation in self.marks().items():
                storage.set_trial_system_attr(number, key, generation)
            return self.number

        def sample_relative(self, study: Any, trial: Any, search_space: Any) -> dict[str, Any]:
            parents = self.get_parent_population(study, self.number)
            if len(parents) < 2:  # a crossover needs two
                return {}
            children: dict[str, Any] = super().sample_relative(study, trial, search_space)
            return children

    return Generations


class OptunaPlugin(BuiltIn[OptunaSettings]):
    """`optimizer: {kind: optuna}`."""

    name = "optuna"
    settings = OptunaSettings

    @property
    def supports(self) -> frozenset[Ability]:
        """See `drivecal.plugins.ports.DeclaringOptimizerPlugin`."""
        return ONE_OBJECTIVE | {"objectives"}

    def _optimizer(self, settings: OptunaSettings, begin: Beginning) -> Replayed:
        return Replayed(begin.population, OptunaEngine(settings, begin.n_values, begin.kinds))


OPTUNA: DeclaringOptimizerPlugin = OptunaPlugin()
