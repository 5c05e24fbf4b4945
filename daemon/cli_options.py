"""What several commands read from the command line in one way."""

from datetime import UTC, datetime
from typing import Any

from daemon.errors import UserError


def instant(text: str, option: str) -> datetime:
    """Return the UTC instant that an option gives as a date or time; raises `UserError`."""
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise UserError(f"{option}: '{text}' is no date or time; write 2022-10-14 or 2022-10-14T08:00Z") from None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


def site_values(text: str) -> dict[str, Any]:
    """Return the site section's values that LAT,LON or LAT,LON,ALT means; raises `UserError`."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise UserError(f"--site: '{text}' is not LAT,LON or LAT,LON,ALT, such as 48.7176,2.2090,156")
    altitude = numbers[2] if len(numbers) == 3 else 0.0
    return {"name": text, "latitude_deg": numbers[0], "longitude_deg": numbers[1], "altitude_m": altitude}
