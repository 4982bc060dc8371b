"""Cells of campaigns by stage: requested cells, and their answers."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import JSON, Connection, Dialect, Label, SmallInteger, Table, select, type_coerce
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction
from sqlalchemy.types import TypeDecorator

from drivecal.contracts.campaign import CellCounts, StageCellCounts
from drivecal.domain.campaigns import StageName
from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.tables import campaign_stages, campaigns
from drivecal.storage.engine.types import STAGES

Counts = StageCellCounts | CellCounts
CountsByStage = Mapping[StageName, Mapping[str, int]]


class _ByStage(TypeDecorator[dict[StageName, dict[str, int]]]):
    """Cell counts by stage, for stages that have begun, in their order."""

    impl = JSON
    cache_ok = True

    def process_result_value(self, value: Any, dialect: Dialect) -> dict[StageName, dict[str, int]]:
        del dialect
        return {STAGES[number]: value[str(number)] for number in sorted(map(int, value or {}))}


class _DocumentByNumber(GenericFunction[Any]):
    """Aggregates rows of (number, document) into one JSON object."""

    type = _ByStage()
    inherit_cache = True


@compiles(_DocumentByNumber, "sqlite")
def _on_sqlite(element: _DocumentByNumber, compiler: SQLCompiler, **options: Any) -> str:
    number, document = (compiler.process(clause, **options) for clause in element.clauses)
    return f"json_group_object({number}, json({document}))"


@compiles(_DocumentByNumber, "postgresql")
def _on_postgresql(element: _DocumentByNumber, compiler: SQLCompiler, **options: Any) -> str:
    return f"json_object_agg({compiler.process(element.clauses, **options)})"


def by_stage(of: Table | Any = campaigns) -> Label[dict[StageName, dict[str, int]]]:
    """Returns the column `stages` of a query over `of`, the campaigns: their counts by stage."""
    number, cells = type_coerce(campaign_stages.c.stage, SmallInteger), type_coerce(campaign_stages.c.cells, JSON)
    query = select(_DocumentByNumber(number, cells)).where(campaign_stages.c.campaign_sequence == of.c.sequence)
    return query.correlate(of).scalar_subquery().label("stages")


def counts(stages: CountsByStage, stage: StageName) -> Counts:
    """The counts of a stage, zeros if it has not begun."""
    kind = CellCounts if stage is StageName.CALIBRATION else StageCellCounts
    return kind(**stages.get(stage, {}))


def save(connection: Connection, campaign_sequence: int, cells: Mapping[StageName, Counts]) -> None:
    """Replaces the counts of some stages of a campaign, of none as well."""
    rows = [
        {"campaign_sequence": campaign_sequence, "stage": stage, "cells": each.model_dump(mode="json")}
        for stage, each in cells.items()
    ]
    if not rows:  # a comparison whose runs have requested nothing yet
        return
    statement = insert(connection, campaign_stages)
    replaced = {"cells": statement.excluded.cells}
    connection.execute(statement.on_conflict_do_update(index_elements=["campaign_sequence", "stage"], set_=replaced), rows)
