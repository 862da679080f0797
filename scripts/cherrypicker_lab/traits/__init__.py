"""Benchmark of the traits: generated trees as cameras see them, measured against their truth."""
