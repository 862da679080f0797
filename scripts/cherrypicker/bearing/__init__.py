"""Bearing wood: the kind and the age of each piece of an axis, as probabilities."""
