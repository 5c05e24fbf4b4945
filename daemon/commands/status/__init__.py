"""Shows people and scripts at a terminal the state of the running service."""
