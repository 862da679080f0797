"""Clouds of a scene: the exact surface, or as our own stereo would see it."""
