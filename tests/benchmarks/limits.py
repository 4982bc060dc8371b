"""What do clients meet at the server's limits? `python tests/benchmarks/run.py limits [--seconds 30] [--times 1 2]`.

While a coordinator carries out a campaign on real SUMO workers, as many clients as it admits ask without a pause: 200 requests at a time,
which poll the campaign, try submissions and queue small campaigns until the queue is full, and 100 event streams. Then twice as many. A
client that is refused waits for as long as `Retry-After` says. Printed for each kind: answers, median and 99th percentile of their times,
and the refusals by status; and the same of /healthz, which has no limit, on a connection that was there first (500 may be open). The
clients share the machine with server and workers.

Good: with as many clients as are admitted only a full queue refuses (429); with more, all refusals are 429 or 503 with `Retry-After`, no
answer is lost, and as many streams as there are places stay open. Times are printed and not judged.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from drivecal.api.http.limits import MOST_REQUESTS
from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.configuration.settings import Settings

HOME = Path(".drivecal/bench/limits").absolute()
TARGET = Path(".drivecal/bench/limits.json")
STREAMS = "streams"
HEALTH = "/healthz"
REFUSALS = {429, 503}
SMALL: dict[str, Any] = {
    "name": "small",
    "catalogue": ["S1"],
    "sensitivity": None,
    "optimizer": {"kind": "random", "population": 10, "iterations": 2, "seed": 1},
    "priority": -100,
}
LONG = SMALL | {"name": "long", "optimizer": SMALL["optimizer"] | {"population": 20_000, "iterations": 100}, "priority": 0}
SHARES = {"polling": 0.7, "trying": 0.2, "posting": 0.1}
"""Shares of the kinds among the requests that are open at a time."""
Figures = dict[str, dict[str, Any]]


@dataclass
class Met:
    """What the clients of one kind met: milliseconds of answers that served them, refusals by status, and what should not be."""

    clients: int
    served: list[float] = field(default_factory=list)
    refused: Counter[int] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    open_at_the_end: int = 0
    answered: asyncio.Event = field(default_factory=asyncio.Event)
    """Set once there are as many answers as clients."""

    def note(self, status: int, headers: Mapping[bytes, bytes], milliseconds: float) -> float:
        """Counts an answer. Returns the seconds after which to ask again."""
        if len(self.served) + self.refused.total() + 1 >= self.clients:
            self.answered.set()
        if status not in REFUSALS:
            self.served.append(milliseconds)
            if status >= 400:
                self.wrong[f"status {status}"] += 1
            return 0.0
        self.refused[status] += 1
        if b"retry-after" not in headers:
            self.wrong[f"status {status} without Retry-After"] += 1
        return float(headers.get(b"retry-after", b"1"))

    def figures(self) -> dict[str, Any]:
        """Returns counts, and percentiles in milliseconds; None without an answer."""
        return {
            "clients": self.clients,
            "served": len(self.served),
            "p50_milliseconds": percentile(self.served, 0.5),
            "p99_milliseconds": percentile(self.served, 0.99),
            "refused": {str(status): number for status, number in sorted(self.refused.items())},
            "wrong": dict(self.wrong),
            "open_at_the_end": self.open_at_the_end,
        }


def percentile(values: list[float], share: float) -> float | None:
    """Returns the smallest value that at least this share of the values does not exceed."""
    return sorted(values)[math.ceil(share * len(values)) - 1] if values else None


class Connection:
    """A client's connection, opened anew if the server closed it."""

    def __init__(self, url: str) -> None:
        self._address = urlsplit(url)
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, method: str, path: str, body: bytes = b"", *, whole: bool = True) -> tuple[int, dict[bytes, bytes]]:
        """Returns status and headers (names in small letters); reads the body as well, if `whole`. Raises OSError and EOFError."""
        if self._streams is None:
            self._streams = await asyncio.open_connection(self._address.hostname, self._address.port)
        reader, writer = self._streams
        head = f"{method} {path} HTTP/1.1\r\nHost: {self._address.netloc}\r\n"
        if body:
            head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n"
        writer.write(head.encode() + b"\r\n" + body)
        first, *lines = (await reader.readuntil(b"\r\n\r\n")).split(b"\r\n")
        headers = {name.lower(): value for name, separator, value in (line.partition(b": ") for line in lines) if separator}
        if whole or int(first.split()[1]) in REFUSALS:
            await reader.readexactly(int(headers.get(b"content-length", b"0")))
        if headers.get(b"connection") == b"close":
            self.close()
        return int(first.split()[1]), headers

    async def line(self) -> bytes:
        """Returns the next line of an answer that goes on; empty at its end."""
        return b"" if self._streams is None else await self._streams[0].readline()

    def close(self) -> None:
        """Closes it; the next request opens another."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


async def asking(url: str, request: tuple[str, str, bytes], met: Met, until: float, pause: float = 0.0) -> None:
    """One client that asks again and again, with a pause of so many seconds after each answer."""
    connection = Connection(url)
    while (begun := time.perf_counter()) < until:
        wait = pause
        try:
            status, headers = await connection.ask(*request)
            wait += met.note(status, headers, 1000 * (time.perf_counter() - begun))
        except (OSError, EOFError) as error:
            met.wrong[type(error).__name__] += 1
            connection.close()
            wait += 0.1
        await asyncio.sleep(min(wait, max(0.0, until - time.perf_counter())))
    connection.close()


async def streaming(url: str, path: str, met: Met, until: float) -> None:
    """One client that follows the campaign's events; its answer's time is that until the stream is open."""
    connection = Connection(url)
    while (begun := time.perf_counter()) < until:
        try:
            status, headers = await connection.ask("GET", path, whole=False)
            wait = met.note(status, headers, 1000 * (time.perf_counter() - begun))
            if status == 200:
                async with asyncio.timeout(until - time.perf_counter()):
                    while await connection.line():
                        pass
                met.wrong["stream ended"] += 1
        except TimeoutError:
            met.open_at_the_end += 1
            break
        except (OSError, EOFError) as error:
            met.wrong[type(error).__name__] += 1
            wait = 0.1
            connection.close()
        await asyncio.sleep(min(wait, max(0.0, until - time.perf_counter())))
    connection.close()


async def load(url: str, campaign: str, clients: Mapping[str, int], seconds: float) -> Figures:
    """Has so many clients of each kind ask at once for so many seconds. Returns what they met, by kind."""
    here = f"/api/v1/campaigns/{campaign}"
    small = json.dumps(SMALL).encode()
    requests = {
        "polling": ("GET", here, b""),
        "trying": ("POST", "/api/v1/campaigns?validate_only=true", small),
        "posting": ("POST", "/api/v1/campaigns", small),
    }
    met = {kind: Met(number) for kind, number in clients.items()} | {HEALTH: Met(1)}
    until = time.perf_counter() + seconds
    async with asyncio.TaskGroup() as group:
        # first: connections are limited, too
        group.create_task(asking(url, ("GET", HEALTH, b""), met[HEALTH], until, pause=0.1))
        for _ in range(clients[STREAMS]):
            group.create_task(streaming(url, f"{here}/events", met[STREAMS], until))
        with suppress(TimeoutError):
            await asyncio.wait_for(met[STREAMS].answered.wait(), seconds)  # a stream that is being opened is a request
        for kind, request in requests.items():
            for _ in range(clients[kind]):
                group.create_task(asking(url, request, met[kind], until))
    return {kind: each.figures() for kind, each in met.items()}


def admitted(times: float) -> dict[str, int]:
    """Returns how many clients of each kind there are at so many times the limits."""
    clients = {kind: round(times * share * MOST_REQUESTS) for kind, share in SHARES.items()}
    return clients | {STREAMS: round(times * Settings().event_streams)}


def judged(times: float, figures: Figures, places: int) -> Iterator[str]:
    """Yields what is not as promised; `places`: of event streams."""
    for kind, each in figures.items():
        for what, number in each["wrong"].items():
            yield f"{times:g} times the limits, {kind}: {number} x {what}"
        allowed = {"429"} if kind == "posting" else set()
        if kind == HEALTH or times <= 1:
            yield from (
                f"{times:g} times the limits, {kind}: refused ({status})" for status in each["refused"].keys() - allowed
            )
    if figures[STREAMS]["open_at_the_end"] != min(places, figures[STREAMS]["clients"]):
        yield f"{times:g} times the limits: {figures[STREAMS]['open_at_the_end']} of {places} streams were open"


def show(times: float, figures: Figures) -> None:
    """Prints a table."""
    print(f"{times:g} times the limits:")
    for kind, each in figures.items():
        shown = [f"{each[f'p{share}_milliseconds'] or math.nan:8.1f}" for share in (50, 99)]
        refused = ", ".join(f"{number} x {status}" for status, number in each["refused"].items()) or "none"
        print(
            f"  {kind:8} {each['clients']:4} clients  {each['served']:7} answers  p50 {shown[0]} ms  p99 {shown[1]} ms  refused: {refused}"
        )


def main() -> int:
    """Measures, prints, writes; 0 if the server keeps its promises."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each load")
    parser.add_argument("--times", type=float, nargs="+", default=[1.0, 2.0], help="clients, as multiples of the limits")
    chosen = parser.parse_args()
    measured: dict[float, Figures] = {}
    with fresh_folder(HOME), coordinator(HOME) as client:
        campaign = client.submit(LONG).id
        while client.campaign(campaign).cells.simulated < 1:
            time.sleep(0.5)
        for times in chosen.times:
            measured[times] = asyncio.run(load(client.url, campaign, admitted(times), chosen.seconds))
            show(times, measured[times])
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps({f"{times:g}": figures for times, figures in measured.items()}, indent=2) + "\n")
    faults = [fault for times, figures in measured.items() for fault in judged(times, figures, Settings().event_streams)]
    print("\n".join(faults) or "all refusals are as promised")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
