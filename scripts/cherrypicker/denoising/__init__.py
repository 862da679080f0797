"""Removal of isolated points and of sky; the photos are witnesses (paper, section Denoising)."""
