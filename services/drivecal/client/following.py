"""Following a campaign by its event stream, which is resumed after a break, or by repeated requests without one."""

import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from drivecal.contracts.campaign import Best, Campaign, CampaignEvent, CampaignProgress
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import InvalidInputError, NotFoundError, OverloadError, UnavailableError
from drivecal.domain.events import EventKind

SILENCE_SECONDS = 60.0
"""Tolerated silence of a server, s; a restart takes less."""
READ_SECONDS = 20.0
"""Silence after which a stream counts as broken; servers send a sign of life every 15 s."""
WAIT_SECONDS = 1.0
"""Default time before the next request."""
EMPTY_STREAMS = 2
"""Number of successive empty streams after which a proxy is assumed to block streams."""

Told = Callable[[CampaignEvent], None]
Sent = CampaignEvent | CampaignProgress | None
"""None: a sign of life."""


@dataclass(slots=True)
class Following:
    """The states of a campaign until its end. Calls `told` with each event, or with later events only if `tells` is False.

    Iterating raises TimeoutError when the monotonic clock passes `deadline`, and UnavailableError if the server is silent from the start
    or for SILENCE_SECONDS.
    """

    ask: Callable[[str, str], tuple[Campaign | None, str, float | None]]
    """Returns the campaign with this id unless its ETag is this one, as `Client.campaign_unless`."""
    events: Callable[[str, int | None], Iterator[Sent]]
    """Yields the events of the campaign after this one until the stream ends, as `Client.events`."""
    identifier: str
    deadline: float | None
    told: Told | None
    tells: bool
    """True once events are told."""
    etag: str = ""
    position: int | None = None
    empty_streams: int = 0
    silent_since: float | None = None
    wait: float = WAIT_SECONDS
    campaign: Campaign | None = None
    """The last known state."""

    def __iter__(self) -> Iterator[Campaign]:
        """Yields the campaign now and after each change."""
        while True:
            answered = yield from self._ask()
            if answered and self._has_ended:
                return
            if answered and self._streams:
                yield from self._stream()
            if not (answered and self._has_ended):  # by what the stream said; what it does not say is asked for at once
                self._pause()

    @property
    def _has_ended(self) -> bool:
        return self.campaign is not None and CampaignState(self.campaign.state).ended

    @property
    def _streams(self) -> bool:
        """True if a stream may be opened. It may be silent for READ_SECONDS, so that none is opened shortly before the deadline."""
        in_time = self.deadline is None or self.deadline - time.monotonic() > READ_SECONDS
        return in_time and self.empty_streams < EMPTY_STREAMS

    def _ask(self) -> Generator[Campaign, None, bool]:
        """Yields a changed campaign, and returns whether there was an answer."""
        try:
            campaign, self.etag, wait = self.ask(self.identifier, self.etag)
        except UnavailableError:
            self.silent_since = self.silent_since or time.monotonic()
            if self.campaign is None or time.monotonic() - self.silent_since > SILENCE_SECONDS:
                raise
            return False
        self.silent_since = None
        self.wait = WAIT_SECONDS if wait is None else wait
        if campaign is not None:
            self.campaign, self.identifier = campaign, campaign.id  # another campaign may begin like an abbreviation
            yield campaign
        return True

    def _stream(self) -> Iterator[Campaign]:
        received = False
        try:
            for sent in self.events(self.identifier, self.position):
                received = received or sent is not None
                campaign = self._take(sent)
                if campaign is not None:
                    yield campaign
                if not self._streams:
                    break
        except (OverloadError, NotFoundError, InvalidInputError):
            self.empty_streams = EMPTY_STREAMS  # no place for another one, or a server that has none
        except UnavailableError:
            pass  # the question that follows says whether the server is away
        self.empty_streams = 0 if received else self.empty_streams + 1

    def _take(self, sent: Sent) -> Campaign | None:
        """Returns the campaign as changed by a message of the stream; None if it changes nothing of a campaign."""
        if self.campaign is None or sent is None:
            return None
        if isinstance(sent, CampaignEvent):
            if sent.id is not None:
                self.position = sent.id
            if self.told is not None and self.tells:
                self.told(sent)
            if sent.kind == EventKind.BEST:
                self.campaign = self.campaign.model_copy(update={"best": Best.model_validate(sent.data)})
            return None
        self.tells = True  # what had happened before comes before the first progress
        self.campaign = self.campaign.model_copy(update=dict(sent))
        return self.campaign

    def _pause(self) -> None:
        if self.deadline is not None and time.monotonic() + self.wait > self.deadline:
            time.sleep(max(0.0, self.deadline - time.monotonic()))
            raise TimeoutError("the campaign has not ended within the time limit; it continues")
        time.sleep(self.wait)


class EventParser:
    """A parser of the server's event streams, which arrive in arbitrary pieces. It drops an event that is incomplete at the end."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, chunk: bytes) -> list[dict[str, str]]:
        """Returns the fields of the events that this chunk completes: `data`, and `event` and `id` if an event has them."""
        *blocks, self._rest = (self._rest + chunk).split(b"\n\n")
        lines = (block.decode(errors="replace").split("\n") for block in blocks)
        fields = (dict(line.split(": ", 1) for line in each if ": " in line) for each in lines)
        return [each for each in fields if "data" in each]


def displayed(states: Iterable[Campaign]) -> Iterator[Campaign]:
    """Yields the states of a campaign; in a notebook it displays each in place of the state before."""
    display = _display()
    shown: Any = None
    for campaign in states:
        if shown is not None:
            shown.update(campaign)
        elif display is not None:
            shown = display(campaign, display_id=True)
        yield campaign


def _display() -> Callable[..., Any] | None:
    """Returns IPython's `display` if this process serves a notebook, else None."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is None:
        return None
    display: Callable[..., Any] = import_module("IPython.display").display
    return display
