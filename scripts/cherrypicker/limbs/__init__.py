"""Limbs: from wood points to axes with radii, for wood of any thickness."""
