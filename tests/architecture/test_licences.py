"""Licences of what the images and a full installation hold: known, and none that its users could not ship."""

import re
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
ROLES = ("api", "dispatcher", "ray-head", "ray-worker")
PERMISSIVE = re.compile(
    r"\b(MIT|BSD|Apache|ISC|PSF|Python Software Foundation|Permission is hereby granted, free of charge)\b", re.IGNORECASE
)
COPYLEFT = re.compile(r"\b(A?GPL|LGPL|MPL|EPL|CDDL|SSPL|EUPL|Mozilla|GNU|Eclipse)", re.IGNORECASE)
WEAK = {
    "certifi": "MPL-2.0",
    "libsumo": "EPL-2.0",
    "psycopg": "LGPL-3.0-only",
    "psycopg-binary": "LGPL-3.0-only",
    "sumo-data": "EPL-2.0",
    "sumolib": "EPL-2.0",
    "traci": "EPL-2.0",
}
"""Copyleft of single files or libraries, which are shipped unchanged; `security.md` lists them."""
NOT_DECLARED = {"fmpy": "BSD-2-Clause, in its file LICENSE.txt"}
"""Packages whose metadata name no licence."""


def shipped() -> set[str]:
    """Names of all packages in the images."""
    texts = [(ROOT / "deploy" / "images" / f"{role}.lock").read_text(encoding="utf-8") for role in ROLES]
    names = {name for text in texts for name in re.findall(r"^([A-Za-z0-9_.-]+)==", text, re.MULTILINE)}
    return {re.sub(r"[-_.]+", "-", name).lower() for name in names}


def licence(name: str) -> str:
    """A package's statement of its licence: an expression, classifiers, or a whole text."""
    about: Any = metadata.metadata(name)
    classifiers = [entry.rpartition(" :: ")[2] for entry in about.get_all("Classifier") or [] if entry.startswith("License ::")]
    return about.get("License-Expression") or ", ".join(classifiers) or " ".join((about.get("License") or "").split())


@pytest.mark.parametrize("name", sorted(shipped()))
def test_a_shipped_package_has_a_licence_that_can_be_shipped(name: str) -> None:
    try:
        text = licence(name)
    except metadata.PackageNotFoundError:
        pytest.skip("not for this system or interpreter")
    if name in NOT_DECLARED:
        assert text == "", "it declares one by now"
    elif name in WEAK:
        assert COPYLEFT.search(text)
        assert WEAK[name].partition(" ")[0].partition("-")[0] in text or "Mozilla" in text
    else:
        assert PERMISSIVE.search(text), f"{name} is under {text or 'no known licence'}"
        assert not COPYLEFT.search(text), f"{name} is under {text}"


def test_every_exception_is_shipped_and_documented() -> None:
    page = (ROOT / "docs" / "pages" / "concepts" / "security.md").read_text(encoding="utf-8")
    assert set(WEAK) | set(NOT_DECLARED) <= shipped()
    assert [name for name in (*WEAK, *NOT_DECLARED) if f"`{name}`" not in page] == []
    assert [expression for expression in WEAK.values() if expression.partition(" ")[0] not in page] == []
