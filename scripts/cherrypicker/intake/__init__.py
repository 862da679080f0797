"""Photos and clouds as cameras, scanners and people leave them, made into what stages read."""
