"""What runs without a rig to keep: simulation, replay, and the studies of energy, gain and calibration."""
