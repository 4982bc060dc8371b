from pathlib import Path

import pytest


@pytest.fixture
def mark(tmp_path: Path) -> str:
    """A word that only this test's processes have in their commands."""
    return f"mark-of-{'-'.join(tmp_path.parts[-3:])}"
