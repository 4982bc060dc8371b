"""A campaign, or a chosen set of it, as a file."""

from collections.abc import Mapping
from typing import Literal

from drivecal.client.answers import raise_for
from drivecal.client.transport import Transport, named


class ChosenSets(Transport):
    """The part of the client that hands results on: to people who read and check them, and to calibration tools."""

    def report(self, identifier: str, form: Literal["html", "zip"] = "html") -> bytes:
        """Returns the report of a campaign or a comparison: one HTML page, or a ZIP archive of the page, its figures (SVG, PNG) and tables
        (CSV)."""
        return b"".join(self._pieces(("campaigns", identifier, "report"), {"format": form}))

    def review(self, identifier: str, rank: int | None = None, front: int | None = None, against: str | None = None) -> str:
        """Returns the review sheet of a set, an HTML page: of a `rank` in the solutions or on the `front`, by default the first of the
        front if there are several objectives. `against`: another set beside it, a rank, a campaign's id, or `ID:RANK`."""
        place = ("campaigns", identifier, "review")
        if against is not None:
            other, *other_rank = against.split(":", 1)
            if not other.isdecimal() or other_rank:
                against = ":".join([self._full_place(("campaigns", other))[-1], *other_rank])
        response = self._request("GET", place, query={"set": rank, "front": front, "against": against})
        raise_for(response, *named(place))
        return response.text

    def calibration_file(
        self,
        identifier: str,
        form: Literal["dcm", "cdfx", "csv"],
        rank: int | None = None,
        front: int | None = None,
        weights: str | None = None,
        score: str | None = None,
        labels: Mapping[str, str] | None = None,
        *,
        everything: bool = False,
    ) -> bytes:
        """Returns a set as a DCM, CDFX or CSV file: of a `rank` in the solutions or on the `front`, as for `review`, under these `weights`
        or this `score`. `labels`: names in the file, by parameter; others keep their own."""
        place = ("campaigns", identifier, "calibration-file")
        listed = [f"{name}={label}" for name, label in (labels or {}).items()]
        chosen_by = {"set": rank, "front": front, "weights": weights, "score": score, "everything": everything or None}
        response = self._request("GET", place, query={"format": form, **chosen_by, "label": listed or None})
        raise_for(response, *named(place))
        return response.content
