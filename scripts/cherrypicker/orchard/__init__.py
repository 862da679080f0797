"""A synthetic orchard with full ground truth: trees, scenes, labelled clouds, photos' truth."""

from cherrypicker.orchard.sampling import AsSeen, sample_scene
from cherrypicker.orchard.scene import Scene, generate_scene

__all__ = ["AsSeen", "Scene", "generate_scene", "sample_scene"]
