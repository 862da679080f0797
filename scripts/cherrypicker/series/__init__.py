"""Two dates of one tree: one frame, the same wood, and what changed."""
