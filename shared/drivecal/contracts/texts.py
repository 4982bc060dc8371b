r"""Texts of users, without characters that steer a terminal or reverse what is read.

Documents from outside may hold neither C1 control characters (\x7f-\x9f) nor marks of direction (\u202a-\u202e, \u2066-\u2069). Documents
that earlier releases stored may, and stay readable: a validation refuses these characters only if its context is `FROM_OUTSIDE`.
"""

import re
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, StringConstraints, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

FROM_OUTSIDE = {"from_outside": True}
_STEERING = r"\x7f-\x9f\u202a-\u202e\u2066-\u2069"
ONE_LINE = rf"^[^\x00-\x1f{_STEERING}]+$"


@dataclass(frozen=True)
class Outside:
    """The pattern of a text that comes from outside, which its schema shows."""

    pattern: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(schema) | {"pattern": self.pattern}

    def _check(self, value: str, info: ValidationInfo) -> str:
        if info.context == FROM_OUTSIDE and not re.search(self.pattern, value):
            raise PydanticKnownError("string_pattern_mismatch", {"pattern": self.pattern})
        return value


_LINE, _OUTSIDE = r"^[^\x00-\x1f\x7f]+$", Outside(ONE_LINE)
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=_LINE), _OUTSIDE]
Label = Annotated[str, StringConstraints(min_length=1, max_length=60, pattern=_LINE), _OUTSIDE]
"""Name of an optimizer in a comparison."""
Choice = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=_LINE), _OUTSIDE]
"""Text that names a choice."""
Tag = Annotated[
    str,
    StringConstraints(min_length=1, max_length=40, pattern=r"^[^\x00-\x20\x7f,]+$"),
    Outside(rf"^[^\x00-\x20{_STEERING},]+$"),
]
"""A word without spaces and commas."""
Comment = Annotated[
    str,
    StringConstraints(max_length=4_000, pattern=r"^[^\x00-\x08\x0b-\x1f\x7f]*$"),
    Outside(rf"^[^\x00-\x08\x0b-\x1f{_STEERING}]*$"),
]
Address = Annotated[
    str,
    StringConstraints(min_length=2, max_length=4_000, pattern=r"^#/[^\x00-\x1f\x7f]*$"),
    Outside(rf"^#/[^\x00-\x1f{_STEERING}]*$"),
]
"""A view of the page: the part of its URL from `#/` on."""
