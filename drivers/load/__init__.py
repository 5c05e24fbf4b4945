"""Electronic loads, which measure the current-voltage curve of a module."""
