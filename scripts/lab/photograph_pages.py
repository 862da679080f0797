"""Photograph the pages of a finished batch for the docs: the tree's, its 3D view, the batch's.

Opens results/summary.html and results/TREE/report.html in headless Chromium (Debian's), drawing in
software, light and of one size, so that pictures change where the pages do. Example:

    python scripts/lab/photograph_pages.py --results results --images docs/images
"""

from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.runner import run, stage_parser

CHROMIUM = "/usr/bin/chromium"
SIZE = {"width": 1200, "height": 800}


def main(results, images, tree):
    """Open each page, wait until it is drawn, save what is seen."""
    pages = {
        "page_batch": Path(results) / "summary.html",
        "page_tree": Path(results) / tree / "report.html",
    }
    for path in pages.values():
        if not path.is_file():
            raise StageError("there is no such page; make demo first", file=path)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport=SIZE, color_scheme="light")
        for name, path in pages.items():
            page.goto(path.resolve().as_uri())
            page.wait_for_load_state("networkidle")
            _save(page, Path(images) / f"{name}.png")
        view = page.locator("canvas").first
        view.scroll_into_view_if_needed()
        page.wait_for_timeout(1500)  # the view draws itself in the meantime
        _save(page, Path(images) / "page_view.png")
        browser.close()


def _save(page, path):
    with atomic_path(path) as partial:
        page.screenshot(path=partial)


parser = stage_parser(__doc__)
parser.add_argument("--results", required=True, help="results of the demo")
parser.add_argument("--images", required=True, help="folder of the pictures")
parser.add_argument("--tree", default="cherry_vase", help="whose page")
run(main, parser, globals().get("snakemake"))
