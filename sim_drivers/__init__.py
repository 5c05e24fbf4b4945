"""The rig, simulated: instrument cores without I/O, the sky they stand under, and their hosts."""
