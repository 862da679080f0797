"""What a photo shows along a ray, as one raster a photo, and what all of them say of a place."""
