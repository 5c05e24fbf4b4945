"""Which faces of a cube can be believed, without anything to compare them with but each other and the sun."""
