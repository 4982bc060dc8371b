"""Setups: everything that decides a run apart from the parameter set, and the fingerprint of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol


def canonical_json(document: object) -> str:
    """Serialises a document to its only canonical text: sorted keys, no white space, shortest floats, no NaN."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def digest(content: bytes) -> str:
    """Returns the content hash used throughout drivecal: BLAKE2b, 128 bits, hexadecimal."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def fingerprint_of(document: Mapping[str, object]) -> str:
    """Returns the fingerprint of a setup's document."""
    return digest(canonical_json(document).encode())


class Setup(Protocol):
    """Everything besides the parameter set that decides a run of a scenario.

    It excludes scores, weights and bounds, so that reruns with others find all stored results.
    """

    @property
    def scenario(self) -> str:
        """Id of the scenario."""

    @property
    def document(self) -> Mapping[str, object]:
        """Content of the fingerprint as plain data."""

    @property
    def fingerprint(self) -> str:
        """Run fingerprint: the digest of `document`."""


@dataclass(frozen=True, slots=True)
class BundleSetup:
    """A scenario of a problem bundle: its `document` holds the simulator section, the scenario's data and the digest of the files."""

    scenario: str
    document: Mapping[str, object]

    @property
    def fingerprint(self) -> str:
        """Run fingerprint: the digest of `document`."""
        return fingerprint_of(self.document)

    @property
    def simulator(self) -> str:
        """Kind of the simulator with the version of its adapter."""
        section: Any = self.document["simulator"]
        return f"{section['kind']} (adapter {self.document['adapter']})"


@dataclass(frozen=True, slots=True)
class DrivenSetup:
    """A scenario driven by a driving function in a vehicle and a traffic simulator."""

    scenario: str
    scenario_digest: str
    """Digest of the scenario's definition and its network's bytes."""
    driving_function: str
    driving_function_version: str
    vehicle: str
    vehicle_version: str
    vehicle_parameters: Mapping[str, float]
    simulator: str
    """Name and version, e.g. `libsumo 1.28.0`."""
    step_seconds: float
    seed: int

    @property
    def document(self) -> dict[str, object]:
        """Content of the fingerprint as plain data."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return values | {"vehicle_parameters": dict(self.vehicle_parameters)}

    @property
    def fingerprint(self) -> str:
        """Run fingerprint: the digest of `document`."""
        return fingerprint_of(self.document)

    @classmethod
    def from_document(cls, document: Mapping[str, object]) -> DrivenSetup:
        """Inverts `document`."""
        return cls(**document)  # type: ignore[arg-type]  # the fields are those written by `document`
