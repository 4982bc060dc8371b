"""Plug-ins of the vehicles. Light enough for the coordinator: workers import the kernels when they create a model."""

from collections.abc import Mapping
from functools import cached_property

from drivecal.domain.vehicles import VehicleParameter
from drivecal.highway.vehicle.parameters import TABLE_8, SingleTrackParameters
from drivecal.highway.vehicle.residual import shipped
from drivecal.plugins.arrays import content_digest
from drivecal.plugins.ports import Vehicle, VehicleModel


class SingleTrack:
    """Linear dynamic single-track model with the values of Table 8 and a fixed tracking controller."""

    name = "single_track"
    version = "1"
    parameters: tuple[VehicleParameter, ...] = TABLE_8

    def create(self, parameters: Mapping[str, float]) -> VehicleModel:
        """Creates the model with these values. Raises InvalidInputError naming the faulty parameter."""
        values = SingleTrackParameters.of(parameters)
        from drivecal.highway.vehicle.model import SingleTrackModel  # numba belongs to workers

        return SingleTrackModel(values)


SINGLE_TRACK: Vehicle = SingleTrack()


class Hybrid:
    """The single-track vehicle with a neural residual on yaw rate and lateral acceleration, see `hybrid.md` next to this file."""

    name = "hybrid"
    parameters: tuple[VehicleParameter, ...] = TABLE_8

    @cached_property
    def version(self) -> str:
        """Version derived from the single track's version and the residual's arrays. Raises DamagedArraysError if these are unusable."""
        return f"1.{SINGLE_TRACK.version}.{content_digest(shipped().arrays)[:8]}"

    def create(self, parameters: Mapping[str, float]) -> VehicleModel:
        """Creates the model with these values and the unchanged residual.

        Raises InvalidInputError naming the faulty parameter, and DamagedArraysError if the residual cannot be used.
        """
        values, residual = SingleTrackParameters.of(parameters), shipped()
        from drivecal.highway.vehicle.model import HybridModel  # numba belongs to workers

        return HybridModel(values, residual)


HYBRID: Vehicle = Hybrid()
