"""What several test modules share."""

import os
from pathlib import Path

import cv2  # noqa: F401
import numpy  # noqa: F401
import pytest
import scipy.linalg  # noqa: F401
from workspace import Workspace

from cherrypicker.runner import keep_openblas_to_one_thread

keep_openblas_to_one_thread()  # of the imports above; test processes share the cores

CHROMIUM = "/usr/bin/chromium"  # Debian's; the pages are tested in it
PROJECT = Path(__file__).resolve().parents[1]
# From two minutes down to a half, the longest first; the first mostly waits
LONGEST = (
    *("test_slurm", "test_workflow_photos", "test_workflow", "test_failed_parts"),
    *("test_reliability_processes", "test_viewer", "test_paper", "test_sfm_pipeline"),
    *("test_segmentation_stems", "test_report", "test_mvs_depth", "test_fuzz_readers"),
)
RANK = {name: rank for rank, name in enumerate(LONGEST)}


def pytest_collection_modifyitems(items):
    """Take the long modules first, then those that start Snakemake: all processes end together."""

    def place(item):
        starts_snakemake = getattr(item.module, "Workspace", None) is Workspace
        return RANK.get(item.module.__name__, len(RANK)), not starts_snakemake

    items.sort(key=place)


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


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium, drawing in software; skips where it is missing."""
    if not Path(CHROMIUM).exists():
        pytest.skip(f"CHROMIUM MISSING: {CHROMIUM} (Debian's package chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="PLAYWRIGHT MISSING")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield started
        started.close()
