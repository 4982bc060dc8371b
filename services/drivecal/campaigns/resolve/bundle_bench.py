"""The bench of a problem bundle: its scenarios, its simulator, and one of its scores."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

from drivecal.bundles.checks import choices_of
from drivecal.bundles.expressions import Constraint, Formula
from drivecal.bundles.fingerprints import score_id, setup_document
from drivecal.bundles.manifest import Manifest, ScoreEntry
from drivecal.bundles.scoring import rate
from drivecal.contracts.work import BundleRequest
from drivecal.domain.constraints import Constraint as Allows
from drivecal.domain.evaluations import Rating
from drivecal.domain.parameters import Parameter
from drivecal.domain.scales import Scale
from drivecal.domain.setups import BundleSetup

REPEATED = 0.02
"""Share of cells that run twice on a simulator that does not claim to be deterministic."""


@dataclass(frozen=True)
class Bundle:
    """A stored problem bundle. `files`: digest of every file except `problem.yaml`; `tools`: what its `probe` answers on the workers, None
    before a worker was asked and without a probe."""

    digest: str
    files: str
    manifest: Manifest
    tools: str | None = None


BundleSource = Callable[[str], Bundle]
"""Returns a bundle by name or digest. Raises NotFoundError."""


def parameters_of(manifest: Manifest) -> tuple[Parameter, ...]:
    """Returns all parameters of a manifest."""
    return tuple(Parameter.declared(name, **entry.model_dump()) for name, entry in manifest.parameters.items())


def constraints_of(manifest: Manifest) -> dict[str, Allows]:
    """Returns the constraints of a manifest by their text."""
    known = choices_of(manifest)
    return {text: Constraint(text, known).holds_in for text in manifest.constraints}


@dataclass(frozen=True)
class BundleBench:
    """Scenarios of a bundle, rated by one of its scores in the coordinator."""

    bundle: Bundle
    scenarios: Collection[str]
    score: str

    @property
    def function(self) -> str:
        """Name of the problem."""
        return self.bundle.manifest.problem

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters of the manifest."""
        return parameters_of(self.bundle.manifest)

    @cached_property
    def setups(self) -> dict[str, BundleSetup]:
        """Setups by scenario."""
        manifest = self.bundle.manifest
        documents = {
            name: setup_document(manifest, name, self.bundle.files, tools=self.bundle.tools) for name in self.scenarios
        }
        return {name: BundleSetup(name, document) for name, document in documents.items()}

    @cached_property
    def requests(self) -> dict[str, BundleRequest]:
        """Run requests to workers by scenario."""
        manifest = self.bundle.manifest
        return {
            name: BundleRequest(
                bundle=self.bundle.digest,
                problem=manifest.problem,
                scenario=name,
                data=manifest.scenarios[name],
                simulator=manifest.simulator.model_dump(mode="json"),
                parameters=tuple(manifest.parameters),
                integers=manifest.integers,
                measures=tuple(manifest.reported),
                failures=manifest.failures,
                series=tuple(manifest.series),
                run_fingerprint=self.setups[name].fingerprint,
                document=self.setups[name].document,
                tools=self.bundle.tools,
                units={parameter: entry.unit for parameter, entry in manifest.parameters.items()},
            )
            for name in self.scenarios
        }

    @property
    def to_probe(self) -> BundleRequest | None:
        """The first scenario's request if a worker has to run the bundle's `probe` first: its answer is part of every setup."""
        if self.bundle.manifest.simulator.probe is None or self.bundle.tools is not None:
            return None
        return next(iter(self.requests.values()))

    @property
    def evaluator_id(self) -> str:
        """Name of the score and digest of its definition."""
        return score_id(self.score, self._entry)

    @cached_property
    def scale(self) -> Scale:
        """Scale of the score."""
        return self._entry.scale(self.score)

    @property
    def needs_series(self) -> bool:
        """Scores are formulas over measures, which are stored."""
        return False

    @property
    def rates(self) -> bool:
        """The coordinator rates."""
        return True

    @property
    def repeated_share(self) -> float | None:
        """A small share unless the manifest claims that the simulator is deterministic."""
        return None if self.bundle.manifest.simulator.deterministic else REPEATED

    def rate(self, scenario: str, metrics: Mapping[str, float | None], failure: str | None) -> Rating | None:
        """Rates a run by its measures; None if it lacks one."""
        del scenario
        known = {name: value for name, value in metrics.items() if value is not None}
        scored = rate(self._formula, self.scale, known, failure)
        return None if scored is None else Rating(scored.value, scored.value, scored.undefined, scored.cut)

    @property
    def _entry(self) -> ScoreEntry:
        return self.bundle.manifest.scores[self.score]

    @cached_property
    def _formula(self) -> Formula:
        return Formula(self._entry.formula)
