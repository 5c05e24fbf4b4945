"""The simulated scanning meters, without input or output."""
