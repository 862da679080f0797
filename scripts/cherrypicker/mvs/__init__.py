"""Dense multi-view stereo: COLMAP workspaces, PatchMatch on the CPU, consistency and fusion."""
