"""One process of heliocube: how its rooms are joined, what it says of itself, and what a person may ask of it."""
