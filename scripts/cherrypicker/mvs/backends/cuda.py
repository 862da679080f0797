"""COLMAP's stereo, where pycolmap was built with CUDA."""

import pycolmap

from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.raster import HIDDEN
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.workspace import GEOMETRIC, Workspace


def run_cuda(
    workspace: Workspace, options: StereoOptions, threads: int, shown: ScanPhotos | None
) -> set[str]:
    """COLMAP's own PatchMatch, which itself skips maps that exist.

    It knows nothing of skies: what a user hides loses its depth afterwards.
    """
    config = workspace.folder / "stereo" / "patch-match.cfg"
    config.write_text(
        "".join(f"{view.name}\n__auto__, {options.n_sources}\n" for view in workspace.views),
        encoding="utf-8",
    )
    pycolmap.patch_match_stereo(workspace.folder)
    made = set()
    for i, view in enumerate(workspace.views):
        if not workspace.has_maps(view, GEOMETRIC):
            continue
        made.add(view.name)
        if shown is not None and (hidden := shown.raster(i) == HIDDEN).any():
            depth = workspace.read_depth(view, GEOMETRIC)
            normals = workspace.read_normals(view, GEOMETRIC)
            depth[hidden], normals[hidden] = 0.0, 0.0
            workspace.write_maps(view, GEOMETRIC, depth, normals)
    return made
