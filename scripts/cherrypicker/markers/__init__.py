"""Printed markers: found in photos, located in space, and the scale that follows from them."""
