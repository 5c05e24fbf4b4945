"""The code of `heliocube gain` between the command line and the science of :mod:`solar.gain`."""
