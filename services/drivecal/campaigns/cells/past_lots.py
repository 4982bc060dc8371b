"""What the lots of predictions so far say: whether a predictor pays, and what was released."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from drivecal.contracts.campaign import Released
from drivecal.reduction.lots import SamplingPlan, most_released
from drivecal.reduction.prediction import MOST_KNOWN, REFIT
from drivecal.storage.lots import LotVerdict, StoredLot

PATIENCE = 3
"""Batches after a training in which a predictor is asked whatever it saves: a single lot may be empty or rejected, and asking costs no more
than a few cells."""
GROWTH = 1.25
"""Growth of the known answers after which a predictor without an accepted lot is tried again."""
LIKELY = 0.25
"""Share of a batch that a predictor is expected to save if it has saved nothing yet."""


TRAINING_SECONDS, SECONDS_PER_ANSWER, SECONDS_PER_VALUE = 0.015, 20e-6, 4e-6
"""CPU time of a training: in any case, for each known answer, and for each parameter of it. Usual times in the place of measured ones:
a dispatcher that was killed trains once more, and its campaign would go on with other lots."""
ASKING_SECONDS = 0.01
"""CPU time of a batch's predictions."""


def pays(lots_so_far: Sequence[StoredLot], known: int, cells: int, parameters: int, cell_seconds: float) -> bool:
    """Whether a scenario's predictor of so many parameters can save more than it costs in a batch of so many cells.

    Training takes most of its time, so all batches since the last training count for another one; without success it waits until clearly
    more answers are `known`. Until a training is due, asking again costs a prediction: it goes on for `PATIENCE` batches, and then as long
    as those alone pay.
    """
    if not lots_so_far:
        return True
    trained_on = lots_so_far[-1].known
    served = [lot for lot in lots_so_far if lot.known == trained_on]
    if known < REFIT * trained_on:
        asked = served[1:]
        return len(asked) < PATIENCE or ASKING_SECONDS * len(asked) <= _saved_seconds(asked, cell_seconds)
    training = training_seconds(trained_on, parameters)
    grown = known >= GROWTH * trained_on and training + ASKING_SECONDS <= LIKELY * cells * cell_seconds
    return grown or training + ASKING_SECONDS * len(served) <= _saved_seconds(served, cell_seconds)


def training_seconds(known: int, parameters: int) -> float:
    """Returns the usual CPU time of a training on so many known answers."""
    return TRAINING_SECONDS + min(known, MOST_KNOWN) * (SECONDS_PER_ANSWER + SECONDS_PER_VALUE * parameters)


def _saved_seconds(served: Sequence[StoredLot], cell_seconds: float) -> float:
    return sum(lot.released for lot in served) * cell_seconds


def released_by_scenario(
    stored: Sequence[StoredLot], scenarios: Iterable[str], limit: float, batches: int, number: Callable[[StoredLot], int]
) -> dict[str, Released]:
    """Sums up lots with a verdict, after so many batches. `number`: of a lot's batch, from 0."""
    of = {name: [lot for lot in stored if lot.scenario == name] for name in scenarios}
    return {name: _released(lots, limit, batches, number(lots[0]) if lots else batches) for name, lots in of.items()}


def _released(stored: Sequence[StoredLot], limit: float, batches: int, early: int) -> Released:
    inspected = [lot for lot in stored if lot.verdict is not None]
    released = sum(lot.released for lot in inspected)
    plans = [(SamplingPlan(lot.size, lot.sample, lot.acceptance), lot.errors or 0) for lot in inspected]
    return Released(
        batches=batches,
        asked=len(stored),
        early=early,
        inspected=sum(lot.size for lot in inspected),
        lots=len(inspected),
        rejected=sum(lot.verdict is LotVerdict.REJECTED for lot in inspected),
        predicted=released,
        sampled=sum(lot.sample for lot in inspected),
        different=sum(lot.errors or 0 for lot in inspected),
        limit=limit,
        upper_95=most_released(plans) / released if released else None,
        seconds=sum(lot.seconds for lot in stored),
    )


def skipped_text(released: Mapping[str, Released]) -> str | None:
    """Returns a note on scenarios whose predictor made no lot in some batches; None if there is none."""
    early = {name: each.early for name, each in released.items()}
    late = {name: each.batches - each.asked - each.early for name, each in released.items()}
    unsure = {name: each.asked - each.lots for name, each in released.items()}
    parts = [
        f"{reason}: {', '.join(f'{name} ({count} of {released[name].batches})' for name, count in counts.items() if count)}"
        for reason, counts in (
            ("because too little was known yet, or every answer was known", early),
            ("because predicting would have cost more than it saves, or every answer was known", late),
            ("because no prediction was sure enough", unsure),
        )
        if any(counts.values())
    ]
    return f"batches without predictions, {'; '.join(parts)}" if parts else None
