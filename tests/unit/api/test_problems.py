"""Every error that drivecal raises has its status, and every one its shape."""

import asyncio
import json
import pickle
import sqlite3

import httpx
import psycopg
import pytest
from fastapi import FastAPI
from sqlalchemy.exc import InternalError, OperationalError, PendingRollbackError

from drivecal.api.http import problems
from drivecal.domain.errors import (
    ConflictError,
    DatabaseError,
    DrivecalError,
    InvalidInputError,
    NotFoundError,
    OverloadError,
    Problem,
    TooLargeError,
    UnavailableError,
)

ERRORS = [
    (InvalidInputError(Problem("weights.S1", "-1 is too small", "give at least 0"), Problem("", "odd \ud800")), 422),
    (NotFoundError("campaign", "\0é"), 404),
    (ConflictError("it runs"), 409),
    (UnavailableError("the database does not answer"), 503),
    (DatabaseError("it is no database"), 503),
    (OverloadError("it is full", 30), 429),
    (TooLargeError(Problem("optimizer", "it is too much", "give less")), 413),
    (OperationalError("SELECT 1", {}, sqlite3.OperationalError("no such table: campaigns")), 503),
    (InternalError("INSERT", {}, psycopg.errors.ReadOnlySqlTransaction("cannot execute INSERT")), 503),
    (PendingRollbackError("the transaction is gone"), 503),
    (DrivecalError("something else"), 500),
    (ZeroDivisionError("a fault of ours"), 500),
]


def answer(error: Exception) -> httpx.Response:
    app = FastAPI()
    problems.install(app)

    @app.get("/")
    async def fail() -> None:
        raise pickle.loads(pickle.dumps(error))

    async def call() -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.get("/")

    return asyncio.run(call())


@pytest.mark.parametrize(("error", "status"), ERRORS, ids=lambda value: type(value).__name__)
def test_each_error_is_a_problem_document_with_its_status(error: Exception, status: int) -> None:
    response = answer(error)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    document = response.json()
    assert set(document) == {"type", "title", "status", "detail", "instance", "errors"}
    assert document["status"] == status
    assert ("retry-after" in response.headers) == (status in {429, 503})


def test_what_a_database_said_is_told_to_nobody_but_the_log() -> None:
    assert "no such table" not in answer(next(error for error, _ in ERRORS if isinstance(error, OperationalError))).text


def test_a_fault_of_ours_tells_the_world_nothing() -> None:
    assert "fault of ours" not in answer(ZeroDivisionError("a fault of ours")).text


def test_field_message_and_remedy_are_listed() -> None:
    document = json.loads(answer(ERRORS[0][0]).text)
    assert document["errors"][0] == {"field": "weights.S1", "message": "-1 is too small", "remedy": "give at least 0"}
