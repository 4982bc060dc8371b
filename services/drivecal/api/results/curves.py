"""Curves and maps of a problem, and the range of a campaign's good sets."""

from dataclasses import replace
from itertools import takewhile

import numpy as np
from sqlalchemy import Connection

from drivecal.api.tables.ranking import ranking
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.shapes import Shape, ShapeEntry
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.campaigns.resolve.workbench import bundles_of
from drivecal.contracts.setup import GoodSets, ShapeAnswer
from drivecal.domain.errors import NotFoundError
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

MOST_SETS = 1000
"""Good sets whose curves are read."""
NEAR = 0.01
"""Largest distance of a good set's objective from the best, in widths of the score's range, if the score has no tolerance."""


def shapes_of(manifest: Manifest) -> dict[str, ShapeAnswer]:
    """Returns the curves and maps of a problem by name."""
    entries = {name: entry for name, entry in manifest.parameters.items() if isinstance(entry, ShapeEntry)}
    return {name: _answer(manifest.shapes[name], entry) for name, entry in entries.items()}


def shapes_with_good_sets(
    database: Database, connection: Connection, campaign: StoredCampaign, begun_with: ResolvedSpec
) -> dict[str, ShapeAnswer]:
    """Returns the curves and maps of a campaign's problem with the range of its good sets; nothing for a problem that is gone."""
    try:
        manifest = bundles_of(connection)(campaign.spec["problem"]).manifest
    except NotFoundError:
        return {}
    answers = shapes_of(manifest)
    if not answers or campaign.best is None:
        return answers
    ranked = ranking(database, campaign, begun_with, None)
    near = ranked.scale.tolerance or NEAR * ranked.scale.span
    feasible = [each for each in ranked.ranked[:MOST_SETS] if each.violation == ranked.ranked[0].violation]
    good = list(takewhile(lambda each: abs(each.objective - feasible[0].objective) <= near + 1e-9, feasible))
    sets = [each.parameters for each in replace(ranked, ranked=good).solutions(0, len(good))]
    if not sets:
        return answers
    values = {name: np.array([shape.values(each) for each in sets]) for name, shape in manifest.shapes.items()}
    ranges = {
        name: GoodSets(sets=len(sets), within=near, lower=each.min(axis=0).tolist(), upper=each.max(axis=0).tolist())
        for name, each in values.items()
    }
    return {name: answer.model_copy(update={"good": ranges[name]}) for name, answer in answers.items()}


def _answer(shape: Shape, entry: ShapeEntry) -> ShapeAnswer:
    described = entry.model_dump(include={"lower", "upper", "step", "unit", "description"})
    weights = [each.tolist() for each in shape.weights]
    axes = [list(axis) for axis in shape.axes]
    return ShapeAnswer(names=list(shape.names), axes=axes, axis_units=list(entry.axis_units), weights=weights, **described)
