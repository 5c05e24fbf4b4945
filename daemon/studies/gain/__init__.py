"""What `heliocube gain` does between the command line and the science of :mod:`solar.gain`."""
