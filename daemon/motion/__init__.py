"""Moving the positioner: one move at a time, judged by telemetry, and stopped when in doubt."""
