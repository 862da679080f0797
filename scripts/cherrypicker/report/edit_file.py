"""A tree's hand corrections as the page goes on with them: its file, to which lines are added."""

import yaml

_HEAD = "# Corrections by hand, see config/README.md\nedits:\n"
_PROBE = "- cut: {at: [0, 0, 0]}\n"


def edit_file(tree: str, text: str) -> dict:
    """Return what the page needs to write the file anew.

    Its `text` at the run is empty where there is none; it has been applied, so it is sound.
    Returned are ``tree``, ``name`` (of the file), ``raw`` (`text`, with one newline at its end),
    ``text`` and ``indent`` (lines ``{indent}- ...`` may follow it) and ``n`` (its edits). ``text``
    is `text` itself, comments and all, but for a list that no line can follow.
    """
    raw = text.rstrip() + "\n" if text.strip() else ""
    entries = (yaml.safe_load(raw) or {}).get("edits") or []
    if not entries:
        start, indent = _HEAD, "  "
    elif (found := _indent(raw, entries)) is not None:
        start, indent = raw, found
    else:
        written = yaml.safe_dump({"edits": entries}, default_flow_style=None, sort_keys=False)
        start, indent = written, ""
    about = {"tree": tree, "name": f"{tree}.yaml", "raw": raw}
    return about | {"text": start, "indent": indent, "n": len(entries)}


def _indent(raw: str, entries: list) -> str | None:
    """Indent of a line that adds an edit to the text; None where no line can."""
    wanted = {"edits": [*entries, *yaml.safe_load(_PROBE)]}
    indents = {line[: len(line) - len(line.lstrip())] for line in raw.splitlines() if "-" in line}
    for indent in sorted(indents, key=len):
        try:
            if yaml.safe_load(raw + indent + _PROBE) == wanted:
                return indent
        except yaml.YAMLError:
            continue
    return None
