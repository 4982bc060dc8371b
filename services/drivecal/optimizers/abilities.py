"""Abilities of optimizers, and calls of plug-ins with and without declared abilities."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from drivecal.domain.parameters import Indices, Kind
from drivecal.plugins.ports import UNDECLARED, Ability, DeclaringOptimizerPlugin, Optimizer, OptimizerPlugin


def supported(plugin: OptimizerPlugin) -> frozenset[Ability]:
    """Returns the abilities of a plug-in; one that declares none has `UNDECLARED`."""
    return plugin.supports if isinstance(plugin, DeclaringOptimizerPlugin) else UNDECLARED


def lacking(plugin: OptimizerPlugin, wanted: Collection[Ability]) -> list[Ability]:
    """Returns the wanted abilities that a plug-in does not have."""
    return sorted(set(wanted) - supported(plugin))


def create(
    plugin: OptimizerPlugin, settings: BaseModel, n_values: Indices, kinds: Sequence[Kind], start: Indices | None = None
) -> Optimizer:
    """Creates an optimizer; see `drivecal.plugins.ports.OptimizerPlugin`."""
    if isinstance(plugin, DeclaringOptimizerPlugin):
        return plugin.create(settings, n_values, start, kinds)
    return plugin.create(settings, n_values, start)


def restore(
    plugin: OptimizerPlugin, settings: BaseModel, n_values: Indices, kinds: Sequence[Kind], state: Mapping[str, Any]
) -> Optimizer:
    """Restores an optimizer; see `drivecal.plugins.ports.OptimizerPlugin`."""
    if isinstance(plugin, DeclaringOptimizerPlugin):
        return plugin.restore(settings, n_values, state, kinds)
    return plugin.restore(settings, n_values, state)
