"""Curves and maps of a problem, and the range of a campaign's good sets."""

from dataclasses import replace
from itertools import takewhile

import numpy as np

from drivecal.api.tables.ranking import solution_pages
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.shapes import ShapeEntry
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.setup import GoodSets, ShapeAnswer
from drivecal.domain.errors import NotFoundError

MOST_SETS = 1000
"""Good sets whose curves are read."""
NEAR = 0.01
"""Largest distance of a good set's objective from the best, in widths of the score's range, if the score has no tolerance."""


def shapes_of(manifest: Manifest) -> dict[str, ShapeAnswer]:
    """Returns the curves and maps of a problem by name."""
    answers = {}
    for name, entry in manifest.parameters.items():
        if isinstance(entry, ShapeEntry):
            shape = manifest.shapes[name]
            about = {"axes": list(map(list, shape.axes)), "axis_units": list(entry.axis_units), "names": list(shape.names)}
            answers[name] = ShapeAnswer.of(entry, weights=[each.tolist() for each in shape.weights], step=shape.grid, **about)
    return answers


def shapes_with_good_sets(stored: StoredRanking) -> dict[str, ShapeAnswer]:
    """Returns the curves and maps of a campaign's problem with the range of its good sets; nothing for a problem that is gone."""
    try:
        manifest = stored_bundles(stored.database)(stored.campaign.spec["problem"]).manifest
    except NotFoundError:
        return {}
    answers = shapes_of(manifest)
    if not answers or stored.campaign.best is None:
        return answers
    ranked = solution_pages(stored)
    scale = stored.resolved.scale
    near = scale.tolerance or NEAR * scale.span
    feasible = [each for each in ranked.ranked[:MOST_SETS] if each.violation == ranked.ranked[0].violation]
    good = list(takewhile(lambda each: abs(each.choice.objective - feasible[0].choice.objective) <= near + 1e-9, feasible))
    sets = [each.parameters for each in replace(ranked, ranked=good).solutions(0, len(good))]
    for name, shape in manifest.shapes.items() if sets else ():
        values = np.array([shape.values(each) for each in sets])
        ends = {"lower": values.min(axis=0).tolist(), "upper": values.max(axis=0).tolist()}
        answers[name] = answers[name].model_copy(update={"good": GoodSets(sets=len(sets), within=near, **ends)})
    return answers
