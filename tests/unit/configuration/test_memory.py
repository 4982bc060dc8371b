"""Memory that goes back to the system, on Linux."""

import subprocess
import sys

import pytest

SETTLED = """
import threading, time, psutil
from drivecal.configuration import memory
memory.EVERY_SECONDS = 0.2
memory.settle()
own = psutil.Process()

def fill():
    kept = [bytes(5_000) for _ in range(40_000)]  # 200 MB in pieces that glibc takes from its pools
    last = bytes(5_000)  # lies above them, so that glibc alone gives nothing back
    print(own.memory_info().rss >> 20, flush=True)
    del kept
    return last

last = fill()
deadline = time.monotonic() + 300
while own.memory_info().rss >> 20 > 150 and time.monotonic() < deadline:
    time.sleep(0.1)
print(own.memory_info().rss >> 20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have another malloc")
def test_memory_that_is_not_used_any_more_goes_back_by_itself() -> None:
    ended = subprocess.run([sys.executable, "-c", SETTLED], capture_output=True, text=True, check=True)
    most, left = map(int, ended.stdout.split())
    assert most > 200
    assert left < 150
