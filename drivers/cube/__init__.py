"""Ways to read the four faces of a cube."""
