"""What several commands share."""

from enum import StrEnum

# Headings of the list of commands.
SERVICE = "The service"
OPERATION = "To the running service"
FILES = "Files and tools"
SCIENCE = "Science"
BENCH = "Instruments and the bench"


class RoleChoice(StrEnum):
    """The roles as the command line names them."""

    both = "both"
    cube = "cube"
    tracker = "tracker"


class TableFormat(StrEnum):
    """Kinds of tables."""

    csv = "csv"
    parquet = "parquet"
