"""The work of a server under faults: two campaigns side by side and a stream of single evaluations, all of it real simulation."""

import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import httpx
from tests.support.effort import tries
from tests.support.serve import TLS

COARSE: list[dict[str, Any]] = [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.25} for i in range(1, 7)]
"""So few values that the search comes back to sets that it has seen."""
SCENARIOS = ["S1", "S2", "S5"]
BOLD_MAP: dict[str, Any] = {
    "parameters": COARSE,
    "catalogue": SCENARIOS,
    "scenarios": {name: {parameter: {"influential": False} for parameter in ("P5", "P6")} for name in SCENARIOS},
}
"""A map that claims too much, so that even a small campaign reuses, and its audits find something."""
REUSING: dict[str, Any] = {
    "name": "reusing",
    "catalogue": SCENARIOS,
    "parameters": COARSE,
    "fixed": {f"P{i}": 0.5 for i in range(7, 12)},
    "optimizer": {"kind": "genetic", "population": tries(40, 50), "iterations": tries(4, 6), "seed": 4, "mutation": 1},
    "reduction": {"mode": "influence", "audit": 0.2, "max_error": 1},
}
ANALYSING: dict[str, Any] = {
    "name": "analysing",
    "catalogue": ["S1", "S2"],
    "parameters": [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.05} for i in range(1, 4)],
    "fixed": {f"P{i}": 0.5 for i in range(4, 12)},
    "vehicle": {"parameters": {"mass": 1600}},
    "sensitivity": {"intervals": tries(2, 3), "samples": 3, "threshold": 0.02},
    "optimizer": {"kind": "genetic", "population": tries(12, 20), "iterations": 3, "seed": 2},
    "reduction": {"mode": "influence", "audit": 0.1, "max_error": 1},
    "robustness": {"delta": 0.02, "steps": 2, "samples": 3, "solutions": tries(1, 2)},
    "validation": {"samples": tries(5, 10), "references": 2, "largest": 20},
}
"""Every stage there is. Its vehicle is another one, so that what it finds does not depend on how far the other campaign is."""
SINGLE: dict[str, Any] = {"scenario": "S3", "vehicle": {"parameters": {"mass": 1700}}}
PATIENCE_SECONDS = 600.0
"""Longest time until a request is accepted, while the server is killed and restarts."""


def post(url: str, path: str, document: Mapping[str, Any], key: str | None = None, patience: float = PATIENCE_SECONDS) -> str:
    """Posts until it is accepted, as a careful client does, with the same key each time; gives the id."""
    headers = {"Idempotency-Key": key or uuid.uuid4().hex}
    deadline = time.monotonic() + patience
    answer: httpx.Response | str = "nothing tried"
    while time.monotonic() < deadline:
        try:
            answer = httpx.post(url + path, json=document, headers=headers, timeout=35.0, verify=TLS)
        except httpx.TransportError as error:
            answer = f"{type(error).__name__}: {error}"
        else:
            if answer.is_success:
                identifier: str = answer.json()["id"]
                return identifier
            assert answer.status_code in {429, 503}, f"{answer.status_code} {answer.text}"
            assert "Retry-After" in answer.headers
        time.sleep(0.2)
    raise AssertionError(f"not accepted within {patience:.0f} s: {answer}")


@dataclass
class Accepted:
    """Ids of what the server has accepted: it has to be there at the end, and ended."""

    campaigns: dict[str, str] = field(default_factory=dict)
    """By name."""
    evaluations: dict[str, list[str]] = field(default_factory=dict)
    """By key: every answer to it."""
    refused: list[str] = field(default_factory=list)
    """Answers that no request may get, whatever is broken: anything but 429 and 503 with a Retry-After."""


def submit(url: str, documents: Mapping[str, Mapping[str, Any]] | None = None) -> Accepted:
    """Posts the campaigns."""
    if documents is None:
        map_id = post(url, "/api/v1/influence-maps", BOLD_MAP)
        reusing = REUSING | {"sensitivity": {"map": map_id}}
        documents = {"reusing": reusing, "analysing": ANALYSING}
    return Accepted({name: post(url, "/api/v1/campaigns", document) for name, document in documents.items()})


@contextmanager
def single_evaluations(url: str, accepted: Accepted) -> Iterator[None]:
    """Posts single evaluations during the block, each twice with one key, and notes the accepted ones."""
    stop = threading.Event()

    def work() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            key = uuid.uuid4().hex
            parameters = {f"P{i}": (number * i) % 11 / 10 for i in range(1, 12)}
            for _ in range(2):
                try:
                    headers = {"Idempotency-Key": key}
                    document = {**SINGLE, "parameters": parameters}
                    answer = httpx.post(f"{url}/api/v1/evaluations", json=document, headers=headers, timeout=10.0, verify=TLS)
                except httpx.TransportError:
                    continue
                if answer.is_success:
                    accepted.evaluations.setdefault(key, []).append(answer.json()["id"])
                elif answer.status_code not in {429, 503} or "Retry-After" not in answer.headers:
                    accepted.refused.append(f"{answer.status_code} {answer.text}")
            stop.wait(1.0)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
