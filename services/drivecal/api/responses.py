"""Builds answers from stored rows."""

import re
import zlib
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import lru_cache
from operator import attrgetter
from typing import Any, get_args

from drivecal.analysis import replicates
from drivecal.api.live.dispatcher_health import degraded
from drivecal.bundles.shapes import Shape
from drivecal.campaigns.resolve.resolved_spec import stored_goals, stored_scale
from drivecal.contracts.campaign import Campaign, FirstObjective, Repaired, Seconds, Spent
from drivecal.contracts.evaluation import EvaluatedCell, Evaluation
from drivecal.contracts.tables import PLACE, EvaluationRow, TableName, parameter_column
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.setups import digest
from drivecal.domain.values import Setting
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.results import StoredEvaluation
from drivecal.storage.revision_queries import CampaignRevision

ROOT = "/api/v1"
SECONDS_BETWEEN_POLLS = 1
"""`Retry-After` of what is still running."""
TABLES = (*get_args(TableName), "results", "setup", "studies", "calibration-file")
"""Links of a campaign besides `events`."""
_FIELDS = tuple(EvaluationRow.model_fields)
_place, _rest = attrgetter(*_FIELDS[:PLACE]), attrgetter(*_FIELDS[PLACE:])


def campaign_answer(stored: StoredCampaign, now: datetime, silent: str | None) -> Campaign:
    """Returns a campaign as clients see it at the moment `now`; `silent` is a message about a silent dispatcher."""
    return Campaign.of(
        stored,
        state=state_of(stored),
        degraded=degraded(stored, silent),
        seconds=seconds_of(stored, now),
        scale=stored_scale(stored.resolution),
        objective=_first_objective(stored),
        curves=_curves(stored),
        **_search(stored),
        links=_links(stored),
    )


def _search(stored: StoredCampaign) -> dict[str, Any]:
    """Returns what is known of a campaign's search and its budget."""
    search, end = stored.search, stored.state.value if stored.state.ended else None
    ended_by = None if search is None else search.ended_by
    minutes = 0.0 if search is None else search.spent_minutes or 0.0
    taken = stored.cells.shared if (stored.spec.get("reduction") or {}).get("isolated") else 0
    return {
        "budget": stored.spec.get("budget"),
        "spent": Spent(simulations=stored.cells.runs - stored.cells.lost + taken, stored=taken, minutes=minutes),
        "ended_by": end if end in {"cancelled", "failed"} and search is not None else ended_by,
        "repaired": Repaired() if search is None else search.repaired,
    }


def _curves(stored: StoredCampaign) -> dict[str, dict[str, Any]]:
    parameters, documents = {} if stored.best is None else stored.best.parameters, (stored.resolution or {}).get("shapes", {})
    shapes = [(Shape.from_document(name, each), each["axes"]) for name, each in documents.items()] if parameters else []
    return {each.name: {"names": each.names, "axes": axes, "values": each.values(parameters)} for each, axes in shapes}


def _first_objective(stored: StoredCampaign) -> FirstObjective | None:
    goals = stored_goals(stored.resolution)
    if goals.is_weighted_score:
        return None
    first = goals.objectives[0]
    return FirstObjective(name=first.name, unit=first.unit, direction="maximise" if first.sign > 0 else "minimise")


def state_of(stored: StoredCampaign) -> CampaignState:
    """Returns the state of a campaign as clients see it: it counts as cancelling as soon as it is asked to cancel."""
    asked = stored.requested_action == "cancel" and not stored.state.ended
    return CampaignState.CANCELLING if asked else stored.state


def seconds_of(stored: StoredCampaign, now: datetime) -> Seconds:
    """Returns the duration of a campaign at the moment `now`, and the CPU time of its simulations."""
    wall = 0.0 if stored.started_at is None else ((stored.ended_at or now) - stored.started_at).total_seconds()
    return Seconds(wall=max(0.0, wall), simulating=stored.simulating_seconds)


def calibration(stored: StoredCampaign, lacks: str = "") -> StoredCampaign:
    """Returns the campaign. Raises ConflictError for a single evaluation; `lacks` says what it lacks."""
    if stored.kind != "calibration":
        raise ConflictError(f"{stored.id} is a single evaluation{lacks}; `drivecal show {stored.id}` prints it")
    return stored


def etag(seen: CampaignRevision, silent: str | None) -> str:
    """Returns the ETag of `campaign_answer`. It is weak, because it does not change with the elapsed time."""
    return f'W/"{seen.id}-{_version(seen, silent)}"'


def list_etag(seen: Sequence[CampaignRevision], silent: str | None) -> str:
    """Returns the ETag of a page."""
    return f'W/"{digest("".join(f"{revision.id}-{_version(revision, silent)} " for revision in seen).encode())}"'


def _version(seen: CampaignRevision, silent: str | None) -> str:
    said = degraded(seen, silent)
    return f"{seen.revision}-{0 if said is None else zlib.crc32(said.encode()):x}"


def matches(if_none_match: str | None, tag: str) -> bool:
    """Returns whether a client has the answer with this ETag, by the weak comparison of RFC 9110, 8.8.3.2."""
    if if_none_match is None:
        return False
    given = {tag.strip().removeprefix("W/") for tag in if_none_match.split(",")}
    return "*" in given or tag.removeprefix("W/") in given


def takes_gzip(accept_encoding: str) -> bool:
    """Returns whether a client accepts gzip (RFC 9110, Section 12.5.3)."""
    return qualities(accept_encoding).get("gzip", 0.0) > 0


def qualities(header: str) -> dict[str, float]:
    """Returns the quality of each name in a header such as `Accept` (RFC 9110, Section 12.4.2), 0 for an unusable quality."""
    listed: dict[str, float] = {}
    for part in header.split(","):
        name, *options = (piece.strip().lower() for piece in part.split(";"))
        quality = next((option[2:] for option in options if option.startswith("q=")), "1")
        listed[name] = float(quality) if _QUALITY.fullmatch(quality) else 0.0
    return listed


_QUALITY = re.compile(r"0(\.\d*)?|1(\.0*)?", re.ASCII)


def _links(stored: StoredCampaign) -> dict[str, str]:
    if stored.kind == "evaluation":
        return {"self": f"{ROOT}/evaluations/{stored.id}"}
    here = f"{ROOT}/campaigns/{stored.id}"
    links = {"self": here, "events": f"{here}/events"} | {table: f"{here}/{table}" for table in TABLES}
    if stored.influence_map_id is not None:
        links["influence_map"] = f"{ROOT}/influence-maps/{stored.influence_map_id}"
    if stored.rerun_of is not None:
        links["rerun_of"] = f"{ROOT}/campaigns/{stored.rerun_of}"
    return links


def evaluation_row(stored: StoredEvaluation) -> dict[str, Any]:
    """Returns a row of the table `evaluations`."""
    row: dict[str, Any] = dict(zip(_FIELDS[:PLACE], _place(stored), strict=True))
    row |= _parameter_columns(stored.parameters)
    row |= zip(_FIELDS[PLACE:], _rest(stored), strict=True)
    row["seed"] = stored.seed if stored.has_seed else None
    return row


@lru_cache(maxsize=1024)
def _parameter_columns(parameters: ParameterSet) -> Mapping[str, Setting]:
    """Returns the values of a set by column: the cells of a set follow each other."""
    return {parameter_column(name): value for name, value in parameters.floats.items()}


def evaluation_answer(stored: StoredCampaign, cells: Sequence[EvaluatedCell]) -> Evaluation:
    """Returns a single evaluation as clients see it; `cells` by scenario, then by seed."""
    scenario, by_scenario = stored.spec["scenario"], dict[str, list[EvaluatedCell]]()
    for cell in cells:
        by_scenario.setdefault(cell.scenario, []).append(cell)
    items = list(map(_over_seeds, by_scenario.values()))
    only = items[0] if scenario is not None and items else None
    by_seed = [_mean([cell.score for cell in run]) for run in zip(*by_scenario.values(), strict=True)]
    return Evaluation.of(
        stored,
        parameters=stored.spec["parameters"],
        scenario=scenario,
        objective=_mean(by_seed),
        **_interval(by_seed),
        items=items,
        **{name: getattr(only, name, None) for name in ("outcome", "score", "rating", "failure", "metrics")},
        unrepeatable=stored.cells.unrepeatable,
        links={"self": f"{ROOT}/evaluations/{stored.id}"},
    )


def _over_seeds(cells: Sequence[EvaluatedCell]) -> EvaluatedCell:
    """Returns the cells of a scenario under several seeds as one."""
    if len(cells) == 1:
        return cells[0]
    scores, outcomes = [cell.score for cell in cells], [cell.outcome for cell in cells]
    names = dict.fromkeys(name for cell in cells for name in cell.metrics or {})
    metrics = {name: [(cell.metrics or {}).get(name) for cell in cells] for name in names}
    changes: dict[str, Any] = {
        "outcome": next((each for each in (None, "failed", "simulated") if each in outcomes), outcomes[0]),
        "score": _mean(scores),
        "rating": _mean([cell.rating for cell in cells]),
        "milliseconds": sum(cell.milliseconds or 0.0 for cell in cells) or None,
        "metrics": {name: _mean(values) for name, values in metrics.items()} or None,
        "within": {name: (ends["lower"], ends["upper"]) for name, each in metrics.items() if (ends := _interval(each))},
        "seeds": [seed for cell in cells for seed in cell.seeds or [1]],
        "failures": sum(cell.failure is not None and cell.score is not None for cell in cells),
        "scores": scores,
        "failure": next((cell.failure for cell in cells if cell.failure), None),
        "detail": next((cell.detail for cell in sorted(cells, key=lambda cell: cell.outcome != "failed") if cell.detail), None),
    }
    return cells[0].model_copy(update=changes | _interval(scores))


def _mean(values: Sequence[float | None]) -> float | None:
    """Returns the mean of values; None if one is missing."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None


def _interval(values: Sequence[float | None]) -> dict[str, float | None]:
    """Returns the standard error of a mean and its 95 % interval; empty if a value is missing, and for equal ones: they tell no noise."""
    known = [value for value in values if value is not None]
    if len(set(known)) < 2 or len(known) < len(values):
        return {}
    lower, upper = replicates.interval(known, None, 0.95)
    return {"standard_error": (replicates.variance(known, 0.0, 0.0) / len(known)) ** 0.5, "lower": lower, "upper": upper}
