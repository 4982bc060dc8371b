"""Writes a report to the folder named by the first argument; its data arrive pickled by standard input, from the API alone.

Drawing takes seconds, and memory that matplotlib never gives back: a process of its own spares the API both.
"""

import pickle
import sys
from pathlib import Path

from drivecal.report.whole import write

if __name__ == "__main__":
    report, page_alone = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the process that started this one
    write(report, Path(sys.argv[1]), page_alone=page_alone)
