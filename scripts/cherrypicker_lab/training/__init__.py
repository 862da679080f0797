"""Training of the two networks, and how good they are."""
