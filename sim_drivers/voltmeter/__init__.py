"""The simulated voltmeter: the converter, the instrument around it, and its commands."""
