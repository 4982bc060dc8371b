"""A parameter set as a CSV table, for people and spreadsheets."""

import csv
import io
from collections.abc import Sequence

from drivecal.calibration_data.characteristics import Characteristic

COLUMNS = ("name", "value", "unit", "lower", "upper", "description")


def write(characteristics: Sequence[Characteristic]) -> bytes:
    """Returns a table (RFC 4180, UTF-8) with one row per characteristic. Numbers keep all their digits."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    writer.writerows([getattr(row, column) for column in COLUMNS] for row in characteristics)
    return text.getvalue().encode()
