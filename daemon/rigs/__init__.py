"""Real and simulated instruments; the only place that reaches the simulators."""
