"""The program that builds the documentation: links between files, inline scripts, and what it does if it cannot."""

import json
from base64 import b64encode
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.documentation import program


@pytest.fixture
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program for a project of two pages and a decision."""
    module = program("build")
    pages, decisions = tmp_path / "docs" / "pages", tmp_path / "shared" / "decisions"
    for folder in (pages / "how-to", decisions, tmp_path / "services/web/public"):
        folder.mkdir(parents=True)
    (tmp_path / "services/web/public/icon.svg").write_text("<svg/>")
    (tmp_path / "docs" / "zensical.toml").write_text("[project]")
    (pages / "index.md").write_text(
        "[decision](../../shared/decisions/001-a.md#why) [all](../../shared/decisions) `[no](link.md)`"
    )
    (pages / "how-to" / "b.md").write_text(
        "[start](../index.md) [code](../../../code.py) [web](https://example.org) ![i](../i.png)"
    )
    (pages / "i.png").write_bytes(b"png")
    (tmp_path / "code.py").write_text("")
    (decisions / "001-a.md").write_text("# 001: A decision\n\n## Why\n")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(module, "TARGET", tmp_path / "help")
    monkeypatch.setattr(module, "INCLUDED", ())
    return module


def test_links_between_files_become_links_between_pages(build: ModuleType, tmp_path: Path) -> None:
    build.stage(tmp_path / "staged")
    pages = tmp_path / "staged" / "pages"
    start = (pages / "index.md").read_text()
    assert start == "[decision](shared/decisions/001-a.md#why) [all](decisions.md) `[no](link.md)`"
    assert (pages / "how-to" / "b.md").read_text() == "[start](../index.md) code [web](https://example.org) ![i](../i.png)"
    assert (pages / "i.png").read_bytes() == b"png"
    assert "[001](shared/decisions/001-a.md) | A decision" in (pages / "decisions.md").read_text()
    assert (tmp_path / "staged" / "zensical.toml").read_text() == "[project]"


def test_a_notebook_becomes_a_page_with_its_outputs(build: ModuleType, tmp_path: Path) -> None:
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": ["a\n", "b\n"]},
        {"output_type": "execute_result", "data": {"text/html": ["<table>", "</table>"], "text/plain": "x"}},
        {"output_type": "display_data", "data": {"image/png": b64encode(b"png").decode()}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "[start](../index.md)"]},
        {"cell_type": "code", "source": "print('a')", "outputs": outputs},
        {"cell_type": "code", "source": "%%writefile my/problem.yaml\nproblem: my\n", "outputs": []},
    ]
    (tmp_path / "docs" / "pages" / "how-to" / "c.ipynb").write_text(json.dumps({"cells": cells}))
    (tmp_path / "docs" / "pages" / "index.md").write_text("[notebook](how-to/c.ipynb)")
    build.stage(tmp_path / "staged")
    pages = tmp_path / "staged" / "pages"
    assert (pages / "index.md").read_text() == "[notebook](how-to/c.md)"
    assert (pages / "how-to" / "c.md").read_text().split("\n\n") == [
        "# Title\n[start](../index.md)",
        "```python\nprint('a')\n```",
        "```text\na\nb\n```",
        "<table></table>",
        "![Output of the cell above](c-1-2.png)",
        '```yaml title="my/problem.yaml"\nproblem: my\n```',
        "[Download this notebook](c.ipynb)\n",
    ]
    assert (pages / "how-to" / "c-1-2.png").read_bytes() == b"png"
    assert (pages / "how-to" / "c.ipynb").is_file()


def test_a_link_to_a_missing_file_is_refused_with_its_page(build: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "docs" / "pages" / "index.md").write_text("[gone](gone.md)")
    with pytest.raises(build.DocumentationError, match=r"index\.md.*gone\.md"):
        build.stage(tmp_path / "staged")


def test_inline_scripts_become_files_and_other_scripts_stay(build: ModuleType, tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "a").mkdir(parents=True)
    (site / "assets").mkdir()
    data = '<script id="d" type="application/json">{}</script><script src="x.js"></script>'
    (site / "a" / "b.html").write_text(f"<script>one();</script>{data}")
    build.without_inline_scripts(site)
    (script,) = (site / "assets").iterdir()
    assert script.read_text() == "one();"
    assert (site / "a" / "b.html").read_text() == f'<script src="../assets/{script.name}"></script>{data}'


def test_without_a_generator_the_reason_is_kept_for_the_server(build: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "find_spec", lambda _: None)
    assert "zensical" in build.build()
    assert [path.name for path in build.TARGET.iterdir()] == ["missing.txt"]


def test_an_unchanged_documentation_is_not_built_again(build: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[Path] = []

    def build_into(target: Path) -> None:
        target.mkdir()
        built.append(target)

    monkeypatch.setattr(build, "build_into", build_into)
    assert build.build() is None
    assert build.build() is None
    assert built == [build.TARGET]
    (build.DOCS / "pages" / "index.md").write_text("changed")
    build.TARGET.joinpath("sources.sha256").unlink()
    build.TARGET.rmdir()
    assert build.build() is None
    assert len(built) == 2
