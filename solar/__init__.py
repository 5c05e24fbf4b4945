"""Pure science of sun tracking: frames, sun, sky and pointing laws. No I/O, no clock, no settings."""
