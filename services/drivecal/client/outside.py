"""Your own optimizer on a campaign: it asks for the values of sets, the server simulates what is not stored."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, Self

from drivecal.client.documents import in_pieces, listed
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.outside.sets import AcceptedSets, AnswerPage, CellAnswered
from drivecal.contracts.specification import Given
from drivecal.domain.errors import ConflictError, DrivecalError

WAIT_SECONDS = 20.0
"""Time for which a request waits for answers, below the usual time limits of proxies."""

Parameters = Mapping[str, Given]


class _Feeding(Protocol):
    """The client's calls about a campaign that others feed."""

    def propose(self, identifier: str, sets: Sequence[Mapping[str, object]]) -> AcceptedSets: ...
    def answers(self, identifier: str, after: int = 0, wait: float = 0.0) -> AnswerPage: ...
    def act(self, identifier: str, action: Literal["finish"]) -> Campaign: ...
    def campaign(self, identifier: str) -> Campaign: ...
    def wait(self, identifier: str) -> Campaign: ...


class SearchEndedError(DrivecalError):
    """The campaign evaluates no more sets: its budget is used up, or it was cancelled."""


@dataclass(frozen=True, slots=True)
class SetAnswer:
    """The answers of a set, by scenario.

    `objective` is the weighted mean of the scores; None without a result in every scenario. `loss` is lower for better sets; a scenario
    without a result counts as a failed run.
    """

    parameters: Parameters
    cells: Mapping[str, CellAnswered]
    objective: float | None
    loss: float


class AskTell:
    """A campaign that evaluates the sets of an optimizer of yours. Leaving the `with` block finishes the campaign.

    SearchEndedError leaves the block without an error, so that the budget ends your loop. After another exception the campaign stays open.
    """

    def __init__(self, client: _Feeding, campaign: Campaign) -> None:
        self._client, self.campaign = client, campaign
        self._last = 0
        self._cells: dict[str, dict[str, CellAnswered]] = {}
        self._weights: Mapping[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> bool:
        is_over = isinstance(error, SearchEndedError)
        if error is None or is_over:
            self.finish()
        return is_over

    def evaluate(self, sets: Iterable[Parameters]) -> list[SetAnswer]:
        """Returns the answers of sets, in their order. The same set again costs nothing, also after a restart of your program.

        Raises:
            InvalidInputError: A value or a combination of values is outside of the campaign's space.
            SearchEndedError: The campaign evaluates no more sets.
        """
        listed = list(sets)
        wanted = {_key(each): each for each in listed}
        is_silent = True
        while keys := [
            key for key in wanted if not self._weights or not self._cells.get(key, {}).keys() >= self._weights.keys()
        ]:
            if is_silent:  # again after a wait without answers: another client may have cancelled some
                for piece in in_pieces([{"key": key, "parameters": json.loads(_text(wanted[key]))} for key in keys]):
                    try:
                        self._weights = self._client.propose(self.campaign.id, piece).weights
                    except ConflictError as error:
                        raise SearchEndedError(str(error)) from error
            is_silent = not self._listen()
        return [self._answer(_key(each)) for each in listed]

    def loss(self, parameters: Parameters) -> float:
        """Returns the loss of a set, as `SetAnswer` has it. Raises as `evaluate`."""
        (answer,) = self.evaluate([parameters])
        return answer.loss

    def finish(self) -> Campaign:
        """Lets the campaign end; nothing changes if it has ended."""
        try:
            return self._client.act(self.campaign.id, "finish")
        except ConflictError:
            return self._client.campaign(self.campaign.id)

    def result(self) -> Campaign:
        """Returns the campaign when it has ended."""
        return self._client.wait(self.campaign.id)

    def _listen(self) -> bool:
        """Waits for answers; returns whether there were any. Raises SearchEndedError if no more will come."""
        answers = self._client.answers(self.campaign.id, after=self._last, wait=WAIT_SECONDS)
        for cell in answers.items:
            self._cells.setdefault(cell.key, {})[cell.scenario] = cell
        self._last = answers.last
        if answers.state == "failed":
            raise DrivecalError(f"campaign {self.campaign.id} failed; `drivecal show {self.campaign.id}` says why")
        if answers.is_complete and not answers.items:
            raise SearchEndedError(f"campaign {self.campaign.id} has ended ({answers.ended_by or answers.state})")
        return bool(answers.items)

    def _answer(self, key: str) -> SetAnswer:
        cells, scale = self._cells[key], self.campaign.scale
        scores = {name: cells[name].score for name in self._weights}
        whole = [(self._weights[name], scale.failed if score is None else score) for name, score in scores.items()]
        mean = math.fsum(weight * score for weight, score in whole)
        objective = None if None in scores.values() else mean
        return SetAnswer(next(iter(cells.values())).parameters, cells, objective, -scale.sign * mean)


def _key(parameters: Parameters) -> str:
    """Returns a name that follows from the values, so that a program that starts again asks for the same sets."""
    return hashlib.blake2b(_text(parameters).encode(), digest_size=12).hexdigest()


def _text(parameters: Parameters) -> str:
    """Returns a set as JSON."""
    return json.dumps({name: parameters[name] for name in sorted(parameters)}, default=listed)
