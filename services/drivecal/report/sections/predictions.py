"""Released predictions that were simulated afterwards."""

from drivecal.contracts.tables import ValidationRow
from drivecal.report.data import Studied
from drivecal.report.markup import Number, paragraph, table
from drivecal.report.sections.errors import errors_text


def validated(studied: Studied[ValidationRow]) -> list[str]:
    """Returns a table of a study of predictions, and its sum."""
    rows = [
        [
            row.scenario,
            row.released,
            row.compared,
            row.different,
            row.beyond,
            Number(f"{(row.beyond or 0) / row.compared:.2%}") if row.compared else None,
            None if row.limit is None else Number(f"{row.limit:.1%}"),
            row.wrong,
            None if row.error_rate is None else Number(f"{row.error_rate:.2%}"),
        ]
        for row in studied.rows
    ]
    header = ["scenario", "released", "simulated", "different", "beyond tolerance", "share", "limit", "wrong", "R_err"]
    content = [
        table(
            header, rows, "Released predictions, simulated afterwards; `limit` bounds the expected share beyond the tolerance"
        )
    ]
    compared, different, wrong = (
        sum(getattr(row, name) for row in studied.rows) for name in ("compared", "different", "wrong")
    )
    return [*content, paragraph(errors_text("predictions", compared, different, wrong))] if compared else content
