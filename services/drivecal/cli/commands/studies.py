"""Studies of a campaign's results: existing studies, by itself or another campaign, and new ones."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import typer

from drivecal.cli.application import code_of_state, tell
from drivecal.cli.views.progress import follow
from drivecal.client.client import Client
from drivecal.contracts.campaign import STUDIES, Campaign, StudyName
from drivecal.contracts.specification import HIGHWAY
from drivecal.domain.campaigns import CampaignState

STAGES = ("optimizer", "sensitivity", *STUDIES)
BENCH = ("problem", "catalogue", "weights", "driving_function", "vehicle", "evaluator")
"""Settings that a study takes from its subject by default."""
_STUDIES = re.compile(rf"( \(({'|'.join(STUDIES)})( in [^()]*)?\))+$")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A wanted study: its given `settings`, and its bench."""

    stage: StudyName
    settings: Mapping[str, Any]
    bench: Mapping[str, Any]

    def is_made_by(self, maker: Campaign) -> bool:
        """Returns whether a campaign's study is the wanted one."""
        settings = maker.spec.get(self.stage) or {}
        same = all(settings.get(name) == value for name, value in self.settings.items())
        return same and _bench(maker) == self.bench


def wanted_of(campaign: Campaign, stage: StudyName, given: Mapping[str, Any]) -> Wanted:
    """Returns the wanted study of a campaign in its own vehicle, with the settings that the user gave."""
    settings = {name: value for name, value in given.items() if value is not None}
    return Wanted(stage, settings, _bench(campaign))


def _bench(campaign: Campaign) -> dict[str, Any]:
    return {"problem": HIGHWAY} | {name: campaign.spec[name] for name in BENCH if name in campaign.spec}


def known(client: Client, campaign: Campaign, wanted: Wanted) -> Campaign | None:
    """Returns the campaign that made the wanted study: itself, else the newest, if it succeeded; one that makes it now is followed to its
    end. None without a study."""
    if campaign.state == CampaignState.SUCCEEDED and campaign.spec.get(wanted.stage) and wanted.is_made_by(campaign):
        return campaign
    for study in client.studies(campaign.id).items:
        state = CampaignState(study.state)
        if (
            study.stage == wanted.stage
            and study.campaign != campaign.id
            and (state is CampaignState.SUCCEEDED or not state.ended)
        ):
            maker = client.campaign(study.campaign)
            if wanted.is_made_by(maker):
                return maker if state is CampaignState.SUCCEEDED else _followed(client, maker)
    return None


def specification(campaign: Campaign, study: str, stages: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the specification of a campaign that makes only the study. A study of a study is named after their common subject."""
    name = f"{_STUDIES.sub('', campaign.name)[:180]} ({study})"
    return {**campaign.spec, **dict.fromkeys(STAGES), **stages, "name": name}


def make(client: Client, campaign: Campaign, study: str, stages: Mapping[str, Any]) -> Campaign:
    """Submits the campaign of `specification` and returns it at its end. Exits unless it succeeds."""
    return _followed(client, client.submit(specification(campaign, study, stages)))


def _followed(client: Client, made: Campaign) -> Campaign:
    tell(f"campaign {made.id} makes the study")
    ended = follow(client, made.id)
    if CampaignState(ended.state) is not CampaignState.SUCCEEDED:
        tell(f"campaign {made.id} {ended.state}{f': {ended.error}' if ended.error else ''}")
        raise typer.Exit(code_of_state(ended.state))
    return ended
