"""Sentences about wrong answers: the number of different scores, and of wrong ones."""


def errors_text(what: str, count: int, different: int, wrong: int) -> str:
    """A sentence about `count` answers that were compared, `what` they are in the plural. Wrong are those that are off by more than one
    point (Eq. 8): R_err alone does not say how many are off by one."""
    differ = f"{different:,} had another score ({different / count:.2%})"
    return f"Of {count:,} {what} {differ}; {wrong:,} were wrong, off by more than one point (R_err {wrong / count:.2%})."
