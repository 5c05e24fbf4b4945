"""The energy benchmark: what pointing laws harvest on measured weather, what it is worth, and where energy is lost."""
