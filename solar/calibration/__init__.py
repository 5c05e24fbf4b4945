"""Calibration of the cube: beside a reference pyranometer, and in place against the sun and a clear sky."""
