"""Two trackers side by side: simulated, measured, corrected and reported as in Andriamahefa et al. (2023)."""
