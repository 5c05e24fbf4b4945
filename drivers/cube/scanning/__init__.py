"""A cube whose four sensors are read by a meter with a switch of its own: one trigger, four channels, one reply."""
