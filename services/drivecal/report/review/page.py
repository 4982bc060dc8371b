"""The review sheet as one page."""

from drivecal.domain.campaigns import CampaignState
from drivecal.report.markup import bullets, command, document, paragraph, rendered
from drivecal.report.review import confidence, sections
from drivecal.report.review.content import UNSEALED, sealed
from drivecal.report.review.data import Review

TASKS = ("Prepared", "Checked", "Released")


def sheet(review: Review) -> str:
    """Returns the page with the digest of its content. Equal data give equal bytes."""
    named = [sections.described(each) for each in review.sets.values()]
    labels = list(review.sets)
    subtitle = named[0] if len(named) == 1 else "; ".join(f"{label}: {name}" for label, name in zip(labels, named, strict=True))
    content = {
        "Question": sections.question(review),
        "Objectives": sections.objectives(review),
        "Result": sections.result(review),
        "Parameters": sections.parameters(review),
        "Front": sections.front(review),
        "Robustness": confidence.robustness(review),
        "Origin of the results": confidence.origin(review),
        "Confidence": confidence.sureness(review),
        "Notes": _notes(review),
        "Signatures": _signatures(),
    }
    title = f"Review: {review.first.campaign.name}"
    values = {"query": review.query, "version": review.version, "digest": UNSEALED}
    subtitle += f". Written by drivecal {review.version}"
    return sealed(document(title, subtitle, _warnings(review), content, "review.html.jinja", **values))


def _warnings(review: Review) -> list[str]:
    drafts = [
        f"Draft: campaign {each.campaign.id} is {each.campaign.state}, and its results may change."
        for each in review.sets.values()
        if not CampaignState(each.campaign.state).ended
    ]
    copied = [
        f"The scores in {', '.join(each.chosen.reused)} of {sections.described(each)} are copied: this very set was not simulated there."
        for each in review.sets.values()
        if each.chosen.reused
    ]
    broken = [
        f"{sections.described(each).capitalize()} breaks constraints by {violation:.1%}."
        for each in review.sets.values()
        if (violation := each.chosen.violation) > 0
    ]
    errors = [each.campaign.error for each in review.sets.values() if each.campaign.error]
    return list(dict.fromkeys([*drafts, *copied, *broken, *errors]))


def _notes(review: Review) -> list[str]:
    notes = dict.fromkeys(note for each in review.sets.values() for note in each.campaign.notes)
    return [bullets(notes)] if notes else []


def _signatures() -> list[str]:
    meaning = (
        "The digest below, at the foot of each printed page and in the file itself, identifies this content. It proves no author: a "
        "signature is one on paper beside the digest, or one of the file by your own tools. The command computes the digest again, asks "
        "the campaign for the same sheet, and names each number that differs."
    )
    return [
        rendered("sign.html.jinja", tasks=TASKS),
        paragraph(meaning),
        command(f"echo {UNSEALED}    # SHA-256 of this file with zeros in its place\ndrivecal review --verify FILE"),
    ]
