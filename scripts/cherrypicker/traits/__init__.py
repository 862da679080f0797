"""Traits of a tree: trunk diameters, height, crown, lengths and branches, with uncertainties."""
