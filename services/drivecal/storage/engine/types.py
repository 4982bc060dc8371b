"""Column types that mean the same on SQLite and PostgreSQL."""

import json
from datetime import UTC, datetime
from functools import partial
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python
from sqlalchemy import JSON, BigInteger, DateTime, Dialect, Double, Integer, SmallInteger, Text
from sqlalchemy.types import TypeDecorator, TypeEngine

from drivecal.domain.campaigns import StageName
from drivecal.domain.scales import plain

Identity = BigInteger().with_variant(Integer(), "sqlite")
"""64 bits on both; SQLite numbers rows by itself only if the type is spelt INTEGER."""

Name = Text().with_variant(Text(collation="C"), "postgresql")
"""Text that is sorted or compared by its bytes on both, whatever the locale of the PostgreSQL cluster."""

Document = JSON(none_as_null=True)
"""JSON as text, never JSONB, which would forget the order of keys (scenarios, parameters); None is SQL's NULL."""


class DocumentOf(TypeDecorator[Any]):
    """A value that pydantic can write, stored as its JSON; None is SQL's NULL."""

    impl = Document
    cache_ok = True

    def __init__(self, of: Any) -> None:
        super().__init__()
        self.of = of
        self._adapter: TypeAdapter[Any] = TypeAdapter(of)

    def process_bind_param(self, value: Any, *_: Dialect) -> Any:
        return None if value is None else self._adapter.dump_python(value, mode="json")

    def process_result_value(self, value: Any, *_: Dialect) -> Any:
        return None if value is None else self._adapter.validate_python(value)


ORDER = {stage: number for number, stage in enumerate(StageName, 1)}
"""Stored numbers of the stages: the database sorts them in running order."""


class StageNumber(TypeDecorator[StageName]):
    """A stage, stored as its position in the life of a campaign."""

    impl = SmallInteger
    cache_ok = True

    def process_bind_param(self, value: StageName | None, *_: Dialect) -> int | None:
        return None if value is None else ORDER[StageName(value)]

    def process_result_value(self, value: int | None, *_: Dialect) -> StageName | None:
        return None if value is None else STAGES[value]


STAGES = {number: stage for stage, number in ORDER.items()}


class Score(TypeDecorator[float]):
    """A score of any scale; whole ones are integers in Python, and so in every table, file and document (`scales.plain`).

    SQLite stores reals in an INTEGER column exactly, and whole ones as integers.
    """

    impl = Double
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[Any]:
        """Returns the column type of a backend."""
        return dialect.type_descriptor(Integer() if dialect.name == "sqlite" else Double())

    def process_result_value(self, value: float | None, *_: Dialect) -> float | None:
        return None if value is None else plain(value)


class UtcDateTime(TypeDecorator[datetime]):
    """A moment: aware on the way in, UTC on the way out. SQLite stores it without its zone, which is always UTC."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, *_: Dialect) -> datetime | None:
        if value is not None and value.tzinfo is None:
            raise ValueError(f"{value} names no time zone; give an aware datetime")
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, *_: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


finite = partial(to_jsonable_python, inf_nan_mode="null")
"""Returns plain data with null for every number that JSON cannot express (NaN, infinities)."""


def to_json(document: Any) -> str:
    """Returns the text of a JSON column; NaN becomes null, which every reader of JSON understands."""
    try:
        return json.dumps(document, allow_nan=False)
    except ValueError:
        return json.dumps(finite(document), allow_nan=False)


def now() -> datetime:
    """Returns the current time in UTC."""
    return datetime.now(UTC)
