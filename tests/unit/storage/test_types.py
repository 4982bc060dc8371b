import json
import math
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy.dialects import sqlite

from drivecal.domain.campaigns import StageName
from drivecal.storage.engine.types import ORDER, StageNumber, UtcDateTime, to_json

DIALECT = sqlite.dialect()

DOCUMENTS = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**80), 2**80) | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


def equal(read: Any, written: Any) -> bool:
    if isinstance(written, float):
        return (
            read == written and math.copysign(1, read) == math.copysign(1, written) if math.isfinite(written) else read is None
        )
    if isinstance(written, dict):
        return list(read) == list(written) and all(equal(read[name], value) for name, value in written.items())
    if isinstance(written, list):
        return len(read) == len(written) and all(map(equal, read, written))
    return bool(read == written)


@given(DOCUMENTS)
def test_documents_are_read_back_bit_by_bit_with_null_for_what_json_cannot_say(document: Any) -> None:
    written = to_json(document)
    assert equal(json.loads(written, parse_constant=pytest.fail), document)


def test_stages_are_stored_in_the_order_in_which_they_run() -> None:
    assert sorted(StageName, key=lambda stage: ORDER[stage]) == list(StageName)
    kind = StageNumber()
    for stage in StageName:
        assert kind.process_result_value(kind.process_bind_param(stage, DIALECT), DIALECT) is stage
    assert kind.process_bind_param(None, DIALECT) is None
    assert kind.process_result_value(None, DIALECT) is None


def test_moments_are_stored_in_utc_whatever_zone_they_come_in() -> None:
    kind = UtcDateTime()
    noon = datetime(2026, 5, 1, 12, tzinfo=timezone(timedelta(hours=2)))
    stored = kind.process_bind_param(noon, DIALECT)
    assert stored == datetime(2026, 5, 1, 10, tzinfo=UTC)
    assert kind.process_result_value(datetime(2026, 5, 1, 10), DIALECT) == noon  # noqa: DTZ001  # as SQLite gives it back
    assert kind.process_result_value(noon, DIALECT) == noon
    with pytest.raises(ValueError, match="time zone"):
        kind.process_bind_param(datetime(2026, 5, 1), DIALECT)  # noqa: DTZ001  # that is what is refused
