"""Cuts that bring a tree to a target, in order, each with what it leaves and how sure that is."""
