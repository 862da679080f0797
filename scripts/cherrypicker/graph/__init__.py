"""From contracted points to the rooted graph with radii (paper, section Graph)."""
