"""Trees grown from a seed: axes, radii and the exact skeleton."""
