"""Messages about campaigns kept in order: labels, deletion."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from drivecal.contracts.campaign import Answer
from drivecal.contracts.specification import Model
from drivecal.contracts.strict_json import Comment, Name, Tag

Archived = Literal["without", "with", "only"]
Tags = Annotated[list[Tag], Field(max_length=20)]


class CampaignChanges(Model):
    """Changes of a campaign's labels; fields that are left out stay. `tags` replaces all tags, `add_tags` and `remove_tags` leave others
    as they are: give these or `tags`. A campaign has at most 20 tags."""

    name: Name | None = None
    tags: Tags | None = None
    add_tags: Tags | None = None
    remove_tags: Annotated[list[Tag], Field(max_length=20)] | None = None
    comment: Comment | None = None
    archived: bool | None = None

    @field_validator("add_tags", "remove_tags")
    @classmethod
    def _not_with_tags(cls, value: list[str] | None, info: ValidationInfo) -> list[str] | None:
        if value is not None and info.data.get("tags") is not None:
            raise ValueError("`tags` replaces all tags already; leave one of them out")
        return value


class Referring(Answer):
    """A campaign that refers to another one. `use` names the needed part."""

    campaign: str
    name: str
    use: str


class Deletion(Answer):
    """The end of a request to delete a campaign: `deleted`, or `archived` because others refer to it."""

    id: str
    deleted: bool
    archived: bool
    referring: list[Referring]
    """The campaigns that keep it from being deleted."""
