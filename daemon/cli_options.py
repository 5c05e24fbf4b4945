"""What several commands read from the command line in one way."""

from datetime import UTC, datetime

from daemon.errors import UserError

# Headings of the list of commands.
SERVICE = "The service"
OPERATION = "To the running service"
FILES = "Files and tools"
SCIENCE = "Science"


def instant(text: str, option: str) -> datetime:
    """Return the UTC instant that an option gives as a date or time; raises `UserError`."""
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise UserError(f"{option}: '{text}' is no date or time; write 2022-10-14 or 2022-10-14T08:00Z") from None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
