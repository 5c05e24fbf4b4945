"""The cube's side: reading the four faces, their calibration, and doubts about them."""
