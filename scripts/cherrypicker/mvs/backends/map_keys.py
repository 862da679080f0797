"""Which settings each depth map was made with, so that what is there is made once."""

from __future__ import annotations

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.workspace import View, Workspace

PHOTOMETRIC, GEOMETRIC = "photometric", "geometric"


class MapKeys:
    """Which settings each existing map was made with, so that it is reused only if they are equal.

    Kept in ``stereo/keys.json``. A key is written before its map, so that a run killed in between
    never leaves a map that counts as newer than it is. A whole map without a key was put there by
    somebody else (another COLMAP) and is kept.
    """

    def __init__(self, workspace: Workspace):
        self._workspace = workspace
        self._path = workspace.folder / "stereo" / "keys.json"
        self._keys: dict[str, str] = read_json(self._path) if self._path.exists() else {}

    def is_current(self, view: View, kind: str, key: str) -> bool:
        """Whether the view's maps of this kind are whole and were made with ``key``."""
        known = self._keys.get(f"{view.name}.{kind}", key)
        return known == key and self._workspace.has_maps(view, kind)

    def announce(self, view: View, kind: str, key: str) -> None:
        """Remove the view's old maps and note the key of those that come."""
        self._workspace.remove_maps(view, kind)
        self._keys[f"{view.name}.{kind}"] = key
        write_json(self._path, dict(sorted(self._keys.items())))
