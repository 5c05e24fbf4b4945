"""Skies: how much light comes from which direction, and which kind of sky it is."""
