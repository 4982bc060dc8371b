"""Setups: everything that decides a run apart from the parameter set, and the fingerprint of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


def canonical_json(document: object) -> str:
    """Serialises a document to its only canonical text: sorted keys, no white space, shortest floats, no NaN."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def digest(content: bytes) -> str:
    """Returns the content hash used throughout drivecal: BLAKE2b, 128 bits, hexadecimal."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def fingerprint_of(document: Mapping[str, object]) -> str:
    """Returns the fingerprint of a setup's document."""
    return digest(canonical_json(document).encode())


def base_of(scenario: str) -> str:
    """Returns the problem's scenario, `S1`, of a campaign's scenario: `S1`, or `S1@eu` with the vehicle of a variant."""
    return scenario.partition("@")[0]


@dataclass(frozen=True, slots=True)
class Setup:
    """Everything besides the parameter set that decides a run of a scenario.

    Its `document` holds the simulator section, the scenario's data, the digest of the problem's files and the versions of installed parts.
    It excludes scores, weights and bounds, so that reruns with others find all stored results.
    """

    scenario: str
    document: Mapping[str, Any]
    """Content of the fingerprint as plain data."""

    @property
    def fingerprint(self) -> str:
        """Run fingerprint: the digest of `document`."""
        return fingerprint_of(self.document)

    @property
    def simulator(self) -> str:
        """Kind of the simulator with the version of its adapter, and the library of SUMO."""
        versions = [f"adapter {self.document['adapter']}", self.document.get("sumo")]
        return f"{self.document['simulator']['kind']} ({', '.join(version for version in versions if version)})"

    @property
    def varied(self) -> Mapping[str, float]:
        """Values of the problem's varied parameters by name."""
        values: Mapping[str, float] = self.document.get("varied", {})
        return values
