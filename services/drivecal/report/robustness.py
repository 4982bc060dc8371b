"""Robustness: Table 9 of the paper, with the rankings by robustness and by nominal quality. Pure."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from drivecal.analysis.robustness import key_of, vehicles_text
from drivecal.analysis.trust import sign_of
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import StudyResult
from drivecal.contracts.tables import OptimumRow, RobustnessRow
from drivecal.report.blocks import Block, Number, Paragraph, Table, fixed, objective_number


def condition(settings: Mapping[str, Any]) -> str:
    """Returns the condition in a few words, e.g. `max ≤ 1`."""
    eta = settings.get("eta", 1.0)
    bound = "eta by scenario" if isinstance(eta, list) else f"{eta:g}"
    return f"{settings['condition'].replace('_', ' ')} {'≤' if settings['condition'] == 'max' else '<'} {bound}"


def _label(studied: StudyResult, vehicles: Collection[str | None]) -> str:
    """Returns the column head of a study."""
    settings, vehicle = studied.study.settings, studied.study.vehicle
    model = f", {vehicle}" if vehicle and len(vehicles) > 1 else ""
    return f"degree: {condition(settings)}, δ = {settings['delta']:g}{model}"


def degree(row: RobustnessRow) -> str:
    """Returns the degree as in Table 9: a lower bound if no box failed."""
    return f"≥ {row.degree}" if row.at_least else f"{row.degree}"


def limits(row: RobustnessRow, settings: Mapping[str, Any]) -> dict[str, float | None]:
    """Returns the scenarios that broke the condition in the smallest failed box, with their deviations (None: no result)."""
    trial = min((trial for trial in row.trials if not trial.holds), key=lambda trial: trial.radius, default=None)
    if trial is None:
        return {}
    eta = settings.get("eta", 1.0)
    bounds = dict(zip(trial.deviations, eta, strict=True)) if isinstance(eta, list) else dict.fromkeys(trial.deviations, eta)

    def breaks(name: str, away: float | None) -> bool:
        return away is None or (away > bounds[name] if settings["condition"] == "max" else away >= bounds[name])

    return {name: away for name, away in trial.deviations.items() if breaks(name, away)}


def by_nominal(rows: Sequence[RobustnessRow], sign: int = 1) -> dict[int, int]:
    """Returns the rank in the nominal vehicle (objective, then rating) by the rank of robustness. `sign`: -1 if lower is better."""

    def worth(row: RobustnessRow) -> tuple[bool, float, float, int]:
        return row.objective is None, -sign * (row.objective or 0.0), -sign * (row.rating or 0.0), row.rank

    return {row.rank: place for place, row in enumerate(sorted(rows, key=worth), 1)}


def robustness_blocks(
    studies: Sequence[StudyResult], optima: Sequence[OptimumRow], campaign: Campaign, drawings: Sequence[Block]
) -> list[Block]:
    """Returns the study, Table 9, the figure, the recommended set."""
    main, *others = studies
    settings, made_by = main.study.settings, main.study.campaign
    of = f" of campaign {settings['of']}" if settings.get("of") not in {None, campaign.id} else ""
    sets = f"best set{of} was" if len(main.robustness) == 1 else f"{len(main.robustness)} best sets{of} were"
    text = (
        f"The {sets} driven in other vehicles: {settings['samples']} in each box, boxes of half width "
        f"k·{settings['delta']:g} of the vehicle parameters' ranges, k = 1 … {settings['steps']}; condition {condition(settings)}. The "
        f"degree of robustness is the number of boxes up to which the condition holds in every scenario. {vehicles_text(settings)}"
    )
    if main.study.vehicle:
        text += f" The vehicle model is {main.study.vehicle}."
    if made_by != campaign.id:
        text += f" Campaign {made_by} made this study."
    recommended = [
        Paragraph(f"Recommended: rank {row.rank}, because it has {row.reason}.", "key")
        for row in main.robustness
        if row.recommended
    ]
    return [Paragraph(text), *recommended, _quality(main, others, sign_of(campaign)), *drawings, _values(main, optima)]


def _quality(main: StudyResult, others: Sequence[StudyResult], sign: int) -> Table:
    """Returns the ranking by robustness with the nominal one."""
    nominal, settings = by_nominal(main.robustness, sign), main.study.settings
    elsewhere = [{key_of(row.parameters): Number(degree(row)) for row in other.robustness} for other in others]
    rows = [
        [
            Number(f"{row.rank}{' *' if row.recommended else ''}"),
            *(nominal[row.rank], objective_number(row.objective), fixed(row.rating, 3)),
            *row.scores.values(),
            Number(degree(row)),
            *(vehicle.get(key_of(row.parameters)) for vehicle in elsewhere),
            Number(f"{row.radius:.4g}"),
            _limited(row, settings),
        ]
        for row in main.robustness
    ]
    vehicles = {study.study.vehicle for study in (main, *others)}
    degrees = [_label(study, vehicles) for study in (main, *others)]
    header = [
        "rank, robust",
        "rank, nominal",
        "objective",
        "rating",
        *main.robustness[0].scores,
        *degrees,
        "δ max",
        "limited by",
    ]
    caption = (
        "Robustness: sorted by degree, then by the objective; * recommended. All scores were simulated in the nominal vehicle: "
        "a set that ranked higher in the search had the score of a reference. δ max: the widest box that holds; limited by: the "
        "scenarios that broke the condition first, with their deviations"
    )
    return Table(header, rows, caption, wrap_header=True)


def _values(studied: StudyResult, optima: Sequence[OptimumRow]) -> Table:
    regions = {key_of(optimum.parameters): optimum.region for optimum in optima}
    rows = [
        [row.rank, *row.parameters.values(), Number(degree(row)), regions.get(key_of(row.parameters)), fixed(row.to_worse, 3)]
        for row in studied.robustness
    ]
    caption = "The sets: parameter values in their units, regions as above, distance to the nearest worse set"
    return Table(["rank", *studied.robustness[0].parameters, "degree", "region", "to worse"], rows, caption)


def _limited(row: RobustnessRow, settings: Mapping[str, Any]) -> str | None:
    distances = limits(row, settings)
    return ", ".join(f"{name} ({'no result' if away is None else f'{away:.2g}'})" for name, away in distances.items()) or None
