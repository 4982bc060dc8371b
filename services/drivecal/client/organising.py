"""Lists of campaigns, their labels and their end."""

from collections.abc import Sequence
from typing import Any

from drivecal.client.transport import Transport
from drivecal.contracts.campaign import Campaign, CampaignPage
from drivecal.contracts.organising import Archived, Deletion, SavedView, SavedViewList


class CampaignLists(Transport):
    """The part of the client that keeps campaigns in order."""

    def campaigns(
        self,
        state: str | None = None,
        limit: int | None = None,
        cursor: str | None = None,
        *,
        tags: Sequence[str] = (),
        archived: Archived = "without",
    ) -> CampaignPage:
        """Returns a page of campaigns, newest first: those with all of the `tags`, by default without archived ones."""
        query: dict[str, Any] = {"tag": list(tags) or None, "archived": None if archived == "without" else archived}
        return self._get(CampaignPage, "campaigns", state=state, limit=limit, cursor=cursor, **query)

    def label(
        self,
        identifier: str,
        *,
        name: str | None = None,
        tags: Sequence[str] | None = None,
        add_tags: Sequence[str] | None = None,
        remove_tags: Sequence[str] | None = None,
        comment: str | None = None,
        archived: bool | None = None,
    ) -> Campaign:
        """Changes the given labels of a campaign; `tags` replaces all tags, `add_tags` and `remove_tags` leave others as they are.

        Raises ConflictError if a campaign that runs is archived.
        """
        lists = {"tags": tags, "add_tags": add_tags, "remove_tags": remove_tags}
        changes: dict[str, Any] = {label: list(value) for label, value in lists.items() if value is not None}
        others = {"name": name, "comment": comment, "archived": archived}
        document = changes | {label: value for label, value in others.items() if value is not None}
        place = ("campaigns", identifier)
        return self._answer(self._request("PATCH", place, document=document), Campaign, place)

    def delete(self, identifier: str) -> Deletion:
        """Deletes an ended campaign, or archives it if others refer to it; what it simulated stays in the reference table.

        Raises ConflictError while it runs.
        """
        place = ("campaigns", identifier)
        return self._answer(self._request("DELETE", place), Deletion, place)

    def saved_views(self, campaign: str | None = None) -> list[SavedView]:
        """Returns the saved views of the page for all campaigns, and those of a `campaign`."""
        return self._get(SavedViewList, "views", campaign=campaign).items
