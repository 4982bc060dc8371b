"""`drivecal top`: several campaigns in a live table."""

from typing import Annotated

import typer
from rich.console import Console

from drivecal.cli.application import JsonOption, UrlOption, app, connect
from drivecal.cli.views.live_table import SearchedCampaign, document, print_plain, show_live, table
from drivecal.cli.views.output import print_json
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.domain.campaigns import CampaignState

ACTIVE = (CampaignState.RUNNING, CampaignState.CANCELLING, CampaignState.PAUSED, CampaignState.QUEUED)


@app.command()
def top(
    identifiers: Annotated[
        list[str] | None, typer.Argument(metavar="[ID]...", help="Campaigns; by default active ones, then the newest others.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=200, help="How many at most.")] = 10,
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="Time between two looks.")] = 2.0,
    once: Annotated[bool, typer.Option("--once", help="Print the table once; the default without a terminal.")] = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show several campaigns in a live table. Ctrl-C ends the table and cancels nothing."""
    console = Console()
    with connect(url) as client:
        overview = Overview(client, identifiers or [], limit)
        if as_json:
            print_json(document(overview.read()))
        elif not console.is_terminal:
            print_plain(overview.read())
        elif once:
            console.print(table(overview.read(), console.width))
        else:
            show_live(overview.read, seconds, console)


class Overview:
    """Reads the campaigns of the table; a search again only after another iteration."""

    def __init__(self, client: Client, identifiers: list[str], limit: int) -> None:
        self._client = client
        self._identifiers = identifiers
        self._limit = limit
        self._searches: dict[str, tuple[object, tuple[float, ...]]] = {}

    def read(self) -> list[SearchedCampaign]:
        """Returns the campaigns as they are now."""
        campaigns = [self._client.campaign(identifier) for identifier in self._identifiers] or self._chosen()
        return [SearchedCampaign(campaign, self._best(campaign)) for campaign in campaigns]

    def _chosen(self) -> list[Campaign]:
        active = [campaign for state in ACTIVE for campaign in self._client.campaigns(state, self._limit).items]
        chosen = {campaign.id: campaign for campaign in [*active, *self._client.campaigns(limit=self._limit).items]}
        return list(chosen.values())[: self._limit]

    def _best(self, campaign: Campaign) -> tuple[float, ...]:
        if "generations" not in campaign.links:
            return ()
        moment, (known, best) = (campaign.state, campaign.iteration), self._searches.get(campaign.id, (None, ()))
        if known != moment:
            rows = self._client.rows(campaign.id, "generations")
            best = tuple(row["best"] for row in rows if row["best"] is not None)
            self._searches[campaign.id] = moment, best
        return best
