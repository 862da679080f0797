"""Shapes and points with no orchard in mind: neighbours, cells, sections, polylines, walks."""
