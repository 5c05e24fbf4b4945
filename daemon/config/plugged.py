"""The laws that the service itself has to name."""

FALLBACK_LAW = "chronometric"
"""Points by ephemeris alone: what is left while there are no good readings."""
