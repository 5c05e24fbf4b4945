"""The simulated electronic loads and the dialects they speak."""
