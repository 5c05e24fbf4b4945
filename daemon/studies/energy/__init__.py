"""The energy benchmark: what pointing laws harvest on measured weather, what that is worth, and what is lost where."""
