"""The POZSOL positioner: its wire format, its telemetry, its reference, and the driver above them."""
