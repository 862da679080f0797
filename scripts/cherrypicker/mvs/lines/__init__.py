"""Thin wood as lines in photos: found, matched, and used as starts of the depths."""
