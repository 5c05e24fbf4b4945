"""The fault campaign: seeded faults and commands against where the axes truly stand."""
