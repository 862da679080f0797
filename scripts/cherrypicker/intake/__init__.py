"""Photos as cameras and people leave them, made into the photos that every stage reads."""
