"""Look-ups of stored results."""

from tests.support.computed import ComputedBackend
from tests.support.runs import working
from tests.support.server import RunningApi, problem_of

from drivecal.client import Client

BASELINE: dict[str, float | str] = {f"P{number}": 0.5 for number in range(1, 12)}


def test_stored_cells_are_found_and_nothing_is_simulated(api: RunningApi) -> None:
    backend = ComputedBackend()
    with Client(api.url) as client:
        assert client.look_up([BASELINE]).items == []
        with working(api.database, backend):
            stored = client.evaluate({"parameters": BASELINE})
            while (stored := client.evaluation(stored.id)).state not in {"succeeded", "failed"}:
                pass
        page = client.look_up([BASELINE | {"P1": 0.1}, BASELINE, dict(reversed(BASELINE.items()))])
        assert page.requested == 18
        own = {item.scenario: (item.id, item.score, item.metrics) for item in stored.items}
        for place in (1, 2):
            cells = [cell for cell in page.items if cell.set == place]
            assert {cell.scenario: (cell.evaluation, cell.score, cell.metrics) for cell in cells} == own
        assert len(page.items) == 12
        assert len(backend.sent) == 6
        assert client.look_up([BASELINE], vehicle={"model": "hybrid"}).items == []


def test_a_lookup_is_refused_by_the_faulty_field(api: RunningApi) -> None:
    for body, field in (
        ({"sets": [BASELINE] * 2_000}, "sets"),
        ({"sets": [BASELINE, BASELINE | {"other": 1}]}, "sets[1].other"),
        ({"sets": [{"P1": 0.5}], "problem": "nonsense"}, "problem"),
    ):
        refused = api.http.post("/api/v1/results/lookup", json=body)
        assert problem_of(refused, 422)["errors"][0]["field"] == field
