"""Where the tracker shall point, and why: modes, persons' wishes, stow, and the pointing laws at work."""
