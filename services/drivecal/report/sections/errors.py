"""Sentences about wrong answers: the number of different scores and of wrong ones, and the meaning of a validation's intervals."""

from collections.abc import Sequence

from drivecal.contracts.tables import ValidationRow


def errors_text(what: str, count: int, different: int, wrong: int) -> str:
    """A sentence about `count` answers that were compared, `what` they are in the plural. Wrong are those that are off by more than one
    point (Eq. 8): R_err alone does not say how many are off by one."""
    differ = f"{different:,} had another score ({different / count:.2%})"
    return f"Of {count:,} {what} {differ}; {wrong:,} were wrong, off by more than one point (R_err {wrong / count:.2%})."


def interval_text(rows: Sequence[ValidationRow]) -> str:
    """A sentence about the 95 % intervals of a validation; empty if nothing was compared."""
    over = {row.interval_over for row in rows if row.compared}
    if not over:
        return ""
    if over == {"bases"}:
        return (
            "Each 95 % interval is one of the mean over base sets (by betting, for any distribution), because variants of one base set are "
            "alike. More base sets narrow it, more variants of each hardly do."
        )
    return (
        "These 95 % intervals (Clopper-Pearson) are too narrow: an earlier version of drivecal took the variants of one base set as "
        "independent. `drivecal validate ID --again` makes the study anew."
    )
