"""The simulated azimuth-elevation rotator and the rotctld in front of it, without input or output."""
