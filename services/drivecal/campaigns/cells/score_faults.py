"""Scores of a stage without a value, and those that were cut off, with those of stored runs that answer cells."""

from collections.abc import MutableMapping, Sequence

from sqlalchemy import Connection

from drivecal.bundles.scoring import cut_text
from drivecal.campaigns.resolve.bench import Bench
from drivecal.domain.evaluations import Donor, Rating
from drivecal.storage.references import runs


class ScoreFaults:
    """Counts them as `unscored` and `cut` among the `counts` of a stage."""

    def __init__(self, bench: Bench, counts: MutableMapping[str, int]) -> None:
        self._bench, self._counts = bench, counts
        self.undefined: str | None = None
        """Reason why the first such score has no value; None before."""
        self.cut: str | None = None
        """Scenario and true value of the first score that was cut off; None before."""

    def note(self, scenario: str, rated: Rating) -> None:
        """Takes the rating of a run."""
        scale = self._bench.scale
        self._counts["unscored"] += rated.undefined is not None
        self.undefined = self.undefined or rated.undefined
        if rated.cut is not None:
            self._counts["cut"] += 1
            self.cut = self.cut or cut_text(scenario, scale.name, rated.cut, scale.failed)

    def note_stored(self, connection: Connection, stored: Sequence[tuple[str, Donor]]) -> None:
        """Takes answers of stored runs, by scenario. Those with the worst score are rated again: only the formula knows what they are."""
        worst = [
            (scenario, donor) for scenario, donor in stored if donor.failure is None and donor.score == self._bench.scale.failed
        ]
        if not self._bench.rates or not worst:
            return
        measures = runs.metrics(connection, {donor.run for _, donor in worst})
        for scenario, donor in worst:
            rated = self._bench.rate(scenario, measures[donor.run], None)
            if rated is not None:
                self.note(scenario, rated)
