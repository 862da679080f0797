"""Shapes and points with no orchard in mind: neighbours, cells, circles, polylines, walks."""
