"""What MkDocs does beyond the pages of this folder.

Files at other places of the project become pages (README, CHANGELOG, model cards), links that lead
out of `docs/` reach copies of the files they name, and equations become MathML. A link to a file
that is not there fails the strict build.
"""

from __future__ import annotations

import html
import logging
import posixpath
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

PROJECT = Path(__file__).resolve().parents[1]
logger = logging.getLogger("mkdocs.hooks")

#: Files of the project outside this folder that are pages of the site.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    ".github/CODE_OF_CONDUCT.md": "conduct.md",
    ".github/SECURITY.md": "security.md",
    "config/README.md": "config.md",
    "resources/demo/README.md": "demo.md",
    "resources/weights/sky_unet.md": "model_sky.md",
    "resources/weights/dgcnn.md": "model_classes.md",
}
_ORIGIN = {page: path for path, page in PAGES.items()}
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s]+)")
_FENCE = re.compile(r"(^```.*?^```\s*?$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: dict) -> Files:
    """Add the pages from elsewhere, and the files that links name."""
    for path, page in PAGES.items():
        text = (PROJECT / path).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    for page in list(files.documentation_pages()):
        for target in _targets(page.content_string, _origin(page.src_uri)):
            copy = f"source/{target}"
            is_new = files.get_file_from_path(copy) is None
            if is_new and _site_path(target) == copy and (PROJECT / target).is_file():
                files.append(File.generated(config, copy, abs_src_path=str(PROJECT / target)))
    return files


def on_page_markdown(markdown: str, page, config: dict, files: Files) -> str:
    """Turn the links of a page as it stands in the project into links of the site."""
    origin = _origin(page.file.src_uri)
    here = posixpath.dirname(page.file.src_uri)

    def replaced(match: re.Match) -> str:
        path, _, anchor = match[1].partition("#")
        target = _resolved(path, origin)
        if target is None:
            logger.warning("%s: the link %s leads out of the project", origin, match[1])
            return match[1]
        if (PROJECT / target).is_dir():
            return posixpath.relpath("architecture.md", here or ".")
        link = posixpath.relpath(_site_path(target), here or ".")
        return f"{link}#{anchor}" if anchor else link

    parts = _FENCE.split(markdown)
    return "".join(part if part.startswith("`") else _LINK.sub(replaced, part) for part in parts)


def on_page_content(content: str, page, config: dict, files: Files) -> str:
    r"""Turn \(...\) and \[...\] into MathML, which needs no script."""
    content = re.sub(
        r'<div class="arithmatex">\\\[(.*?)\\\]</div>',
        lambda match: convert(html.unescape(match[1]).strip(), display="block"),
        content,
        flags=re.DOTALL,
    )
    return re.sub(
        r'<span class="arithmatex">\\\((.*?)\\\)</span>',
        lambda match: convert(html.unescape(match[1]).strip()),
        content,
        flags=re.DOTALL,
    )


def _origin(src_uri: str) -> str:
    """Where in the project a page comes from."""
    return _ORIGIN.get(src_uri, f"docs/{src_uri}")


def _resolved(path: str, origin: str) -> str | None:
    target = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
    return None if target.startswith("../") else target


def _site_path(target: str) -> str:
    if target in PAGES:
        return PAGES[target]
    return target.removeprefix("docs/") if target.startswith("docs/") else f"source/{target}"


def _targets(markdown: str, origin: str) -> list[str]:
    """Files of the project that a page links to."""
    text = "".join(part for part in _FENCE.split(markdown) if not part.startswith("`"))
    found = (_resolved(match[1].partition("#")[0], origin) for match in _LINK.finditer(text))
    return [target for target in found if target is not None]
