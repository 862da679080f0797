"""A synthetic orchard with full ground truth: trees, scenes, labelled clouds, photos' truth."""
