"""COLMAP's stereo, where pycolmap was built with CUDA."""

from __future__ import annotations

import pycolmap

from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.workspace import GEOMETRIC, Workspace


def run_cuda(
    workspace: Workspace, options: StereoOptions, threads: int, sky_masks: SkyMasks | None
) -> set[str]:
    """COLMAP's own PatchMatch, which itself skips maps that exist.

    It knows no masks: what a user hides loses its depth afterwards.
    """
    config = workspace.folder / "stereo" / "patch-match.cfg"
    config.write_text(
        "".join(f"{view.name}\n__auto__, {options.n_sources}\n" for view in workspace.views),
        encoding="utf-8",
    )
    settings = pycolmap.PatchMatchOptions()
    settings.filter_min_num_consistent = options.min_consistent
    pycolmap.patch_match_stereo(workspace.folder, options=settings)
    made = [view for view in workspace.views if workspace.has_maps(view, GEOMETRIC)]
    if sky_masks is not None:
        for view in made:
            hidden = sky_masks.both(view)[1]
            if hidden.any():
                depth = workspace.read_depth(view, GEOMETRIC)
                normals = workspace.read_normals(view, GEOMETRIC)
                depth[hidden], normals[hidden] = 0.0, 0.0
                workspace.write_maps(view, GEOMETRIC, depth, normals)
    return {view.name for view in made}
