"""The report's page in a headless Chromium, where one is installed."""

from pathlib import Path

import pytest
from tests.support.browser import chromium, opened, printed
from tests.unit.report.rows import findings

from drivecal.report.data import Report
from drivecal.report.writing import write


@pytest.mark.slow
def test_the_page_opens_without_network_and_without_a_complaint_and_can_be_printed(tmp_path: Path) -> None:
    chromium()
    page = write(Report(findings(), {}), tmp_path / "report")[-1]
    found = opened(page, tmp_path)
    assert found.console == []
    assert found.requests == []
    assert found.dom.count("<svg") == 6
    assert found.dom.rstrip().endswith("</html>")
    assert printed(page, tmp_path).startswith(b"%PDF")


def test_a_page_that_fetches_or_fails_would_be_seen(tmp_path: Path) -> None:
    chromium()
    page = tmp_path / "bad.html"
    page.write_text('<html><body><img src="http://127.0.0.1:9/one.png"><script>undefined_function()</script></body></html>')
    found = opened(page, tmp_path)
    assert found.requests == ["http://127.0.0.1:9/one.png"]
    assert any("undefined_function is not defined" in line for line in found.console)
