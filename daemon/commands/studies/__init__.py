"""Commands over a span of time: simulate, replay, energy, gain, calibrate, compare."""
