"""The harness sees what it is there to see: orphans, and campaigns that found something else."""

import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace

import psutil
import pytest
from tests.support.faults import cage
from tests.support.faults.findings import OF_A_CAMPAIGN, TABLES, Found, assert_equal
from tests.support.faults.patience import Patience
from tests.support.serve import alive, until

ORPHAN = "import os, time; os.fork() and os._exit(7); os.setsid(); os.fork() and os._exit(0); time.sleep(600)"
"""A process that leaves its parents, its session and its terminal, as a daemon does."""


def test_a_daemon_does_not_escape_the_cage_and_ends_with_it() -> None:
    caged = subprocess.Popen([sys.executable, cage.__file__, sys.executable, "-c", ORPHAN], stdin=subprocess.PIPE)
    family: list[psutil.Process] = []

    def only_the_daemon_is_left() -> bool:
        with suppress(psutil.NoSuchProcess, ProcessLookupError):  # a process may end between two questions
            family[:] = [process for process in psutil.Process(caged.pid).children(recursive=True) if alive(process)]
            return [process.ppid() for process in family] == [caged.pid] and os.getsid(family[0].pid) != os.getsid(caged.pid)
        return False

    until(only_the_daemon_is_left, "a daemon that the cage has adopted")
    assert caged.poll() is None
    assert caged.stdin is not None
    caged.stdin.close()
    assert caged.wait(60) == 7, "the command's own exit code"
    assert not any(alive(item) for item in family)


def test_what_others_do_costs_no_patience() -> None:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        family = [psutil.Process(item.pid) for item in burners]
        begin = time.monotonic()
        ours, theirs = Patience(60.0, lambda: family), Patience(60.0, list)
        until(lambda: min(sum(process.cpu_times()[:2]) for process in family) > 0.4, "that they burn")
        spent = theirs.spent(), ours.spent(), time.monotonic() - begin
        assert sorted(spent) == list(spent), spent
        assert spent[1] - spent[0] > 0.2, spent
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def test_whatever_a_campaign_found_differently_is_named() -> None:
    row = {"scenario": "S1", "score": "5"}
    one = Found(dict.fromkeys(OF_A_CAMPAIGN), {name: [row] for name in TABLES}, {("setup", "set"): ("metrics",)})
    assert_equal("same", one, one)
    others = [replace(one, campaign={**one.campaign, name: 1}) for name in OF_A_CAMPAIGN]
    others += [replace(one, tables={**one.tables, name: [{**row, "score": "4"}]}) for name in TABLES]
    others += [replace(one, tables={**one.tables, name: []}) for name in TABLES]
    others += [
        replace(one, runs=runs) for runs in ({}, {("setup", "set"): ("others",)}, {("setup", "other set"): ("metrics",)})
    ]
    for other in others:
        with pytest.raises(AssertionError, match="campaign this"):
            assert_equal("this", other, one)
