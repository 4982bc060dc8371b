"""The notebooks of the documentation run in a real kernel, against a real server, and give what they store."""

from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from tests.support.documentation import DOCS, program
from tests.support.serve import serving

pytestmark = pytest.mark.timeout(900)  # a cell may take SECONDS of docs/notebooks.py
notebooks = program("notebooks")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A server that clients find by their environment."""
    folder = tmp_path_factory.mktemp("server")
    cache = str(folder / "cache")
    with (
        serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=cache) as running,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        patch.setenv("DRIVECAL_URL", running.url)
        patch.setenv("DRIVECAL_BUNDLE_CACHE", cache)
        yield


@pytest.mark.slow
@pytest.mark.parametrize("path", notebooks.NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.usefixtures("server")
def test_a_notebook_gives_what_it_shows(path: Path, tmp_path: Path) -> None:
    stored = notebooks.stored(path)
    nbformat.validate(stored)
    assert notebooks.shown(notebooks.executed(path, tmp_path)) == notebooks.shown(stored), "type: python docs/notebooks.py"


def test_both_notebooks_are_there_with_tables_and_charts() -> None:
    assert [path.stem for path in notebooks.NOTEBOOKS] == ["first-campaign", "own-function"]
    assert notebooks.NOTEBOOKS[0].is_relative_to(DOCS)
    for path in notebooks.NOTEBOOKS:
        kinds = {kind for outputs in notebooks.shown(notebooks.stored(path)) for output in outputs for kind in output}
        assert {"text/html", "image/png"} <= kinds
