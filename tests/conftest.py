"""What several test modules share."""

import os
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def project():
    """The project's root."""
    return PROJECT


@pytest.fixture(scope="session")
def real_data():
    """The folder of real data, which is not ours to ship; skips where it is missing."""
    folder = Path(os.environ.get("CHERRYPICKER_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"REAL DATA MISSING: {folder} (set CHERRYPICKER_DATA)")
    return folder
