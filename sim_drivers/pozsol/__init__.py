"""The simulated POZSOL unit: its controller, its axes, and what it shows on its screen."""
