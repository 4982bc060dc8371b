"""The hybrid vehicle as a plug-in: light enough for the coordinator, the kernels are imported when a worker creates a model."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins.arrays import content_digest
from drivecal.plugins.ports import Vehicle, VehicleModel
from drivecal.vehicle.parameters import TABLE_8, SingleTrackParameters
from drivecal.vehicle.residual import shipped
from drivecal.vehicle.single_track import SINGLE_TRACK


class Hybrid:
    """The single-track vehicle with a neural residual on yaw rate and lateral acceleration, see `hybrid.md` beside this file."""

    name = "hybrid"
    parameters: tuple[VehicleParameter, ...] = TABLE_8

    @cached_property
    def version(self) -> str:
        """Follows the single track's version and the residual's arrays. Raises DamagedArraysError where these cannot be used."""
        return f"1.{SINGLE_TRACK.version}.{content_digest(shipped().arrays)[:8]}"

    def create(self, parameters: Mapping[str, float]) -> VehicleModel:
        """The model with these values; the residual stays as it is. Raises InvalidInputError naming the parameter that does not fit,
        DamagedArraysError where the residual cannot be used."""
        values, residual = SingleTrackParameters.of(parameters), shipped()
        from drivecal.vehicle.model import HybridModel  # numba belongs to workers

        return HybridModel(values, residual)


HYBRID: Vehicle = Hybrid()
