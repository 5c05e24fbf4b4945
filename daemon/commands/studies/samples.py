"""`heliocube samples`: the sample days, to try the other commands on."""

from pathlib import Path
from typing import Annotated

import typer

from daemon.base.errors import UserError
from daemon.base.files import atomic_output_path
from daemon.commands.answers import say
from daemon.commands.options import ForceOption
from daemon.store.outputs import check_outputs


def samples(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; created if it is missing.")],
    force: ForceOption = False,
) -> None:
    """Copy three sample days: what a cube reads and the weather, clear, mixed and overcast (simulated; CC0)."""
    import shutil

    from daemon.studies.samples import DAYS, LICENCE, SITE, sample

    sources = [*map(sample, DAYS), LICENCE]
    check_outputs([out / source.name for source in sources], "--out", force=force)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out: {out} cannot be a folder: {error.strerror}") from None
    for source in sources:
        try:
            # Whole or not at all: half a day would pass for a recording with a gap.
            with atomic_output_path(out / source.name) as part:
                shutil.copyfile(source, part)
        except OSError as error:
            raise UserError(f"--out: {out} cannot take {source.name}: {error.strerror}") from None
    say(f"written to {out}: {', '.join(source.name for source in sources)}")
    say(f"SIMULATED; site {SITE.latitude_deg:g},{SITE.longitude_deg:g},{SITE.altitude_m:g}; free to use (CC0-1.0)")
