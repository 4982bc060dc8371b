"""Plug-in of the single-track vehicle. Light enough for the coordinator: workers import the kernels when they create a model."""

from collections.abc import Mapping

from drivecal.domain.vehicles import VehicleParameter
from drivecal.highway.vehicle.parameters import TABLE_8, SingleTrackParameters
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
