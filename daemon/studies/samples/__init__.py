"""Sample days that come with the program: what a cube reads and what the weather is, minute by minute, all simulated.

Each file is at once a recording of a cube (``time,east,south,west,zenith``) and a weather file (``ghi,dni,dhi,
wind_speed,temp_air``). CC0-1.0: use them for anything.
"""

from pathlib import Path

from daemon.base.errors import UserError
from solar.ephemeris import Site

SITE = Site(48.7176, 2.2090, 156.0)
# Each has a date of its own, so that several files make one run of days.
DAYS = {"clear": "2022-10-12", "mixed": "2022-10-13", "overcast": "2022-10-14"}
COLUMNS = (
    *("time", "east", "south", "west", "zenith"),
    *("ghi", "dni", "dhi", "wind_speed", "temp_air", "simulated"),
)
_FOLDER = Path(__file__).parent
LICENCE = _FOLDER / "LICENSE.txt"


def sample(name: str) -> Path:
    """Return the file of a sample day: ``clear``, ``mixed`` or ``overcast``.

    Parameters
    ----------
    name
        Name of the day.

    Returns
    -------
    A CSV file with a line for each minute of a day of October 2022 at 48.7176 N, 2.2090 E: ``time`` (UTC), the faces
    ``east,south,west,zenith`` as a cube's sensors give them, ``ghi,dni,dhi`` [W/m2], ``wind_speed`` [m/s], ``temp_air``
    [degC], and ``simulated``, which is true throughout. `heliocube.read_faces` and ``weather=`` of `heliocube.simulate`
    take it.

    Raises
    ------
    UserError
        There is no day of that name.
    """
    if name not in DAYS:
        raise UserError(f"there is no sample day '{name}': choose {', '.join(DAYS)}")
    return _FOLDER / f"{name}.csv"
