"""Trackers in rows: what neighbours take from each other's beam, and where a tracker turns to be out of their shade."""
