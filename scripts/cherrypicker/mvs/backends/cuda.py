"""COLMAP's stereo, where pycolmap was built with CUDA."""

from __future__ import annotations

import hashlib

import pycolmap

from cherrypicker.mvs.backends.map_keys import GEOMETRIC, PHOTOMETRIC, MapKeys
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.workspace import Workspace


def run_cuda(
    workspace: Workspace, options: StereoOptions, threads: int, sky_masks: SkyMasks | None
) -> set[str]:
    """COLMAP's own PatchMatch, which itself skips maps that exist; it knows no masks."""
    keys = MapKeys(workspace)
    key = hashlib.sha256(f"cuda:{options.n_sources}".encode()).hexdigest()
    for view in workspace.views:
        for kind in (PHOTOMETRIC, GEOMETRIC):
            if not keys.is_current(view, kind, key):
                keys.announce(view, kind, key)
    config = workspace.folder / "stereo" / "patch-match.cfg"
    config.write_text(
        "".join(f"{view.name}\n__auto__, {options.n_sources}\n" for view in workspace.views),
        encoding="utf-8",
    )
    settings = pycolmap.PatchMatchOptions()
    settings.filter_min_num_consistent = options.min_consistent
    pycolmap.patch_match_stereo(workspace.folder, options=settings)
    return {view.name for view in workspace.views if workspace.has_maps(view, GEOMETRIC)}
