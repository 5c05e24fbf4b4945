"""What several commands share."""

# Headings of the list of commands.
SERVICE = "The service"
OPERATION = "To the running service"
FILES = "Files and tools"
SCIENCE = "Science"
BENCH = "Instruments and the bench"
