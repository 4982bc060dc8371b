"""Influence maps: submission, list, and rows."""

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from drivecal.api.dependencies import Accept, DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import FormQuery, PageQuery, form_of
from drivecal.api.responses import ROOT
from drivecal.api.tables.influence import map_rows
from drivecal.api.tables.paging import FILES, download
from drivecal.campaigns.resolve.maps import EXPERT, resolve_map
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.contracts.inventory import InfluenceMapAnswer, InfluenceMapPage
from drivecal.contracts.specification import InfluenceMapSpecification
from drivecal.contracts.tables import InfluenceRow, columns_of, file_row
from drivecal.storage import admission
from drivecal.storage.references import influence_maps
from drivecal.storage.references.influence_maps import StoredInfluenceMap

router = APIRouter(prefix="/influence-maps", tags=["influence maps"], route_class=StrictRoute)


@router.post("", status_code=201)
def post(specification: InfluenceMapSpecification, response: Response, database: DatabaseDependency) -> InfluenceMapAnswer:
    """Stores a map, its bounds checked against the grid of its parameters. Campaigns name it in `sensitivity: {map: ID}`."""
    posted = resolve_map(specification, stored_bundles(database))
    with database.transaction() as connection:
        admission.admit_map(connection, EXPERT)
        stored = influence_maps.insert(connection, **posted)
    answer = _answer(stored, with_rows=True)
    response.headers["Location"] = answer.links["self"]
    return answer


@router.get("")
def list_maps(query: PageQuery, database: DatabaseDependency) -> InfluenceMapPage:
    """Influence maps, newest first, without their rows."""
    page, following = database.query(influence_maps.page, limit=query.limit, cursor=query.cursor)
    return InfluenceMapPage(items=[_answer(stored, with_rows=False) for stored in page], next_cursor=following)


@router.get("/{map_id}", response_model=InfluenceMapAnswer, responses={200: FILES})
def read(map_id: str, query: FormQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """An influence map with its rows, as a table with `Accept: text/csv` or `format`. Unlisted parameters count as influential."""
    stored = database.query(influence_maps.get, map_id)
    form = form_of(query, accept)
    answer = _answer(stored, with_rows=True)
    if form == "json":
        return JSONResponse(answer.model_dump(mode="json"), headers={"Vary": "Accept"})
    rows = [file_row(row) for row in answer.rows or []]
    return download(f"influence-map-{stored.id}", form, columns_of(InfluenceRow), [rows])


def _answer(stored: StoredInfluenceMap, *, with_rows: bool) -> InfluenceMapAnswer:
    return InfluenceMapAnswer.of(
        stored,
        rows=map_rows(stored) if with_rows else None,
        basis=dict(stored.basis) if with_rows and stored.basis is not None else None,
        links={"self": f"{ROOT}/influence-maps/{stored.id}"},
    )
