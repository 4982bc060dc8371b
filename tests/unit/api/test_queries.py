"""Which format a client asks for."""

import pytest

from drivecal.api.http.queries import TableOf, form_of


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        ("*/*", "json"),
        ("", "json"),
        ("text/csv", "csv"),
        ("TEXT/CSV; charset=utf-8", "csv"),
        ("application/vnd.apache.parquet", "parquet"),
        ("application/json, text/csv", "json"),
        ("text/csv, */*;q=0.1", "csv"),
        ("text/csv;q=0.5, application/json;q=0.9", "json"),
        ("text/html,application/xhtml+xml,*/*;q=0.8", "json"),
        ("text/csv;q=x, application/json", "json"),
        (",;q=,", "json"),
    ],
)
def test_the_accept_header_chooses_the_format(accept: str, form: str) -> None:
    assert form_of(TableOf(), accept) == form


def test_the_query_beats_the_accept_header() -> None:
    assert form_of(TableOf(format="json"), "text/csv") == "json"
