"""What a person or a script at a terminal asks the running service."""
