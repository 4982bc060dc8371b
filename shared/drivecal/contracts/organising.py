"""Changes of campaigns' labels."""

from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from drivecal.contracts.specification import Model
from drivecal.contracts.strict_json import Name, Tag

Tags = Annotated[list[Tag], Field(max_length=20)]


class CampaignChanges(Model):
    """Changes of a campaign's labels; fields that are left out stay. `tags` replaces all tags, `add_tags` and `remove_tags` leave others
    as they are: give these or `tags`. A campaign has at most 20 tags."""

    name: Name | None = None
    tags: Tags | None = None
    add_tags: Tags | None = None
    remove_tags: Annotated[list[Tag], Field(max_length=20)] | None = None

    @field_validator("add_tags", "remove_tags")
    @classmethod
    def _not_with_tags(cls, value: list[str] | None, info: ValidationInfo) -> list[str] | None:
        if value is not None and info.data.get("tags") is not None:
            raise ValueError("`tags` replaces all tags already; leave one of them out")
        return value
