"""Skies: what light comes from where, and how it is told what kind of sky there is."""
