"""The report behind `make audit`."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.support.tree import loaded

AUDIT = loaded("audit", Path(__file__).parents[2] / "deploy" / "audit.py")
SOUND: dict[str, Any] = {"name": "sound", "version": "1", "vulns": []}
UNKNOWN: dict[str, Any] = {
    "name": "unknown",
    "skip_reason": "Dependency not found on PyPI and could not be audited: unknown (1)",
}
WEAKNESS: dict[str, Any] = {"id": "PYSEC-1", "aliases": ["CVE-1"], "fix_versions": ["2", "3"], "description": "long"}
WEAK: dict[str, Any] = {"name": "weak", "version": "1", "vulns": [WEAKNESS, WEAKNESS | {"fix_versions": []}]}


def answering(code: int, answer: str = "", message: str = "") -> list[str]:
    """A command that answers and ends so."""
    script = f"import sys; sys.stdout.write({answer!r}); sys.stderr.write({message!r}); sys.exit({code})"
    return [sys.executable, "-c", script]


@pytest.mark.parametrize(
    ("packages", "weaknesses", "named"),
    [
        ([SOUND], 0, set()),
        ([SOUND, UNKNOWN], 0, {"unknown"}),
        ([WEAK, SOUND, UNKNOWN], 2, {"PYSEC-1", "CVE-1", "2, 3", "unknown"}),
    ],
)
def test_the_report_has_a_line_for_each_weakness(packages: list[dict[str, Any]], weaknesses: int, named: set[str]) -> None:
    answer = json.dumps({"dependencies": packages, "fixes": []})
    lines, weak = AUDIT.report(AUDIT.asked(answering(int(weaknesses > 0), answer), 60))
    assert (len(lines), weak) == (weaknesses + 1, weaknesses > 0)
    assert {name for name in named if name not in "\n".join(lines)} == set()


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (answering(1, message="Traceback\n  cause: Connection refused\n"), "cause: Connection refused"),
        (answering(0), "no answer"),
        (["/no/uv"], "/no/uv: No such file or directory"),
        (["echo", "[]"], "no answer"),
    ],
    ids=["offline", "silent", "no uv", "another program"],
)
def test_a_registry_that_cannot_be_asked_is_named_in_one_line_and_fails_nothing(
    command: list[str], reason: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(AUDIT, "command", lambda: command)
    assert AUDIT.main() == 0
    [line] = capsys.readouterr().out.splitlines()
    assert line.endswith(reason)


def test_an_index_that_knows_no_package_is_no_good_news() -> None:
    with pytest.raises(LookupError):
        AUDIT.report([UNKNOWN])


def test_known_weaknesses_end_the_command_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AUDIT, "command", lambda: answering(1, json.dumps({"dependencies": [WEAK]})))
    assert AUDIT.main() == 1
