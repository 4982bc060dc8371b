"""Released predictions that were simulated afterwards."""

from drivecal.contracts.tables import ValidationRow
from drivecal.domain.scales import Scale
from drivecal.report.data import Studied
from drivecal.report.markup import paragraph, table
from drivecal.report.rows import PREDICTIONS, errors_text, predictions, totals


def validated(studied: Studied[ValidationRow], scale: Scale) -> list[str]:
    """Returns a table of a study of predictions, and its sum in units of the scale."""
    caption = "Released predictions, simulated afterwards; limit: of the expected number beyond the tolerance, for each prediction in a lot"
    content = [table(PREDICTIONS, predictions(studied.rows), caption)]
    compared, different, wrong = totals(studied.rows, "compared", "different", "wrong")
    return [*content, paragraph(errors_text("predictions", compared, different, wrong, scale))] if compared else content
