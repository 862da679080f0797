"""Who computes the depth maps: our PatchMatch on the CPU, or COLMAP with CUDA."""
