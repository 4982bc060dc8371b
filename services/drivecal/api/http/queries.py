"""The query parameters. Unknown ones are refused, so that a slip of the pen is not silently ignored."""

from typing import Annotated, Literal, get_origin

from fastapi import Query
from fastapi.routing import APIRoute
from pydantic import BaseModel, Field, StringConstraints
from starlette.requests import HTTPConnection

from drivecal.api.responses import ROOT, qualities
from drivecal.contracts.strict_json import ONE_LINE, Tag, shown
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import InvalidInputError, Problem

Form = Literal["json", "csv", "parquet"]

Place = Annotated[int, Field(ge=0, le=2**31 - 1)]

PARQUET = "application/vnd.apache.parquet"
FORMS: dict[str, Form] = {
    "text/csv": "csv",
    PARQUET: "parquet",
    "application/json": "json",
    "application/*": "json",
    "*/*": "json",
}


class Parameters(BaseModel, extra="forbid", frozen=True):
    """The base of all query parameters."""


def check_names(connection: HTTPConnection) -> None:
    """Raises InvalidInputError for parameters that the operation does not have, and for parameters that are given twice and are no list.

    Probes and the page's files may be asked with any.
    """
    route = connection.scope.get("route")
    if not connection.query_params or not isinstance(route, APIRoute) or not connection.url.path.startswith(ROOT):
        return
    fields = route.dependant.query_params
    kinds = (field.field_info.annotation for field in fields)
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    given = [name for name, _ in connection.query_params.multi_items()]
    names = dict.fromkeys(given)
    problems = []
    if not models:  # `Parameters` refuse unknown names by themselves
        known = {field.alias for field in fields}
        problems = [Problem(shown(name), "there is no such field", "leave it out") for name in names if name not in known]
    lists = {
        field.alias or name
        for model in models
        for name, field in model.model_fields.items()
        if get_origin(field.annotation) is list
    }
    problems += [
        Problem(shown(name), "it is given more than once", "give it once")
        for name in names
        if name not in lists and given.count(name) > 1
    ]
    if problems:
        raise InvalidInputError(*problems)


class PageOf(Parameters):
    """A page of a list."""

    limit: Annotated[int, Field(ge=1, le=1000)] = 100
    """Largest number of items."""
    cursor: Annotated[str, StringConstraints(max_length=500)] | None = None
    """`next_cursor` of the page before."""


class CampaignsOf(PageOf):
    """A page of campaigns: with several tags campaigns that have all of them."""

    state: CampaignState | None = None
    tag: Annotated[list[Tag], Field(max_length=20)] = []


class ProblemsOf(PageOf):
    """A page of problems; `name`: every push of one name."""

    name: Annotated[str, StringConstraints(max_length=64)] | None = None


class FormOf(Parameters):
    """Format of the answer; an `Accept` header can ask for it as well."""

    format: Form | None = None


class TableOf(PageOf, FormOf):
    """A page of a table; `format` csv or parquet, or such an `Accept` header, returns the whole table.

    With `where` only some rows: `outcome=reused`, `P1>=0.5`. A page may hold fewer then, and the next one goes on.
    """

    where: Annotated[list[Annotated[str, StringConstraints(max_length=300)]], Field(max_length=2000)] = []
    """Conditions on columns of the file, COLUMN=VALUE, COLUMN>=NUMBER or COLUMN<=NUMBER; several values of a column are alternatives."""


class RankedOf(Parameters):
    """A ranking by weights such as `S1=2,S2=1`; other scenarios have weight 1. `score`: another one of the problem, or `NAME@PUSH`: a
    score that another push of it declares, by its name or digest. `variant`: one of the campaign's, for which sets are ranked."""

    weights: Annotated[str, StringConstraints(max_length=20_000)] | None = None
    score: Annotated[str, StringConstraints(max_length=300)] | None = None
    variant: Annotated[str, StringConstraints(max_length=64)] | None = None


class SolutionsOf(TableOf, RankedOf):
    """A page of ranked solutions."""


class EvaluationsOf(TableOf):
    """A page of evaluations; with `measures`, the measures of the run that answered each follow behind all other columns."""

    measures: bool = False


class SummaryOf(Parameters):
    """A front, ranked by weights of the objectives such as `comfort=2,gap=1`; others have weight 1."""

    weights: Annotated[str, StringConstraints(max_length=20_000)] | None = None


class FrontOf(TableOf, SummaryOf):
    """A page of a front."""


class ImportanceOf(RankedOf):
    """The `scenario` whose score is explained; without it the objective of the ranking."""

    scenario: Annotated[str, StringConstraints(min_length=1, max_length=200)] | None = None


class PlaceOf(Parameters):
    """A set by a place in the search: `iteration` and `individual`, both counted from 0."""

    iteration: Place | None = None
    individual: Place | None = None

    @property
    def place(self) -> tuple[int, int] | None:
        """The place; None if none is given. Raises InvalidInputError for half of one."""
        if self.iteration is None and self.individual is None:
            return None
        if self.iteration is None or self.individual is None:
            missing = "iteration" if self.iteration is None else "individual"
            raise InvalidInputError(Problem(missing, "a set is named by iteration and individual", "give both, or neither"))
        return self.iteration, self.individual


class CellOf(Parameters):
    """A set of the ranking by `iteration` and `individual`, and a scenario."""

    iteration: Place
    individual: Place
    scenario: Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=ONE_LINE)]


class SubmissionOf(Parameters):
    """Options of a submission."""

    validate_only: bool = False
    """Check it and count its runs, store nothing."""


PageQuery = Annotated[PageOf, Query()]
CampaignsQuery = Annotated[CampaignsOf, Query()]
ProblemsQuery = Annotated[ProblemsOf, Query()]
FormQuery = Annotated[FormOf, Query()]
TableQuery = Annotated[TableOf, Query()]
EvaluationsQuery = Annotated[EvaluationsOf, Query()]
SolutionsQuery = Annotated[SolutionsOf, Query()]
SummaryQuery = Annotated[SummaryOf, Query()]
FrontQuery = Annotated[FrontOf, Query()]
ImportanceQuery = Annotated[ImportanceOf, Query()]
PlaceQuery = Annotated[PlaceOf, Query()]
CellQuery = Annotated[CellOf, Query()]
SubmissionQuery = Annotated[SubmissionOf, Query()]


def form_of(query: FormOf, accept: str) -> Form:
    """Returns the requested format: of the query, else of the `Accept` header, else JSON."""
    if query.format is not None:
        return query.format
    wanted = [
        (quality, FORMS[media_type]) for media_type, quality in qualities(accept).items() if media_type in FORMS and quality
    ]
    return max(wanted, key=lambda choice: choice[0], default=(0.0, "json"))[1]
