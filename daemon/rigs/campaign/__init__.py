"""The rig of the fault campaign in memory: the instruments, their faults, and one service after another on them."""
