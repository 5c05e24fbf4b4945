"""`heliocube samples`: the sample days, to try the other commands on."""

from pathlib import Path
from typing import Annotated

import typer

from daemon.commands.answers import say
from daemon.commands.options import ForceOption


def samples(
    out: Annotated[Path, typer.Option(help="Folder for them; made if it is not there.")], force: ForceOption = False
) -> None:
    """Copy three sample days: what a cube reads and the weather, clear, mixed and overcast (simulated; CC0)."""
    import shutil

    from daemon.studies.report.write import check_output
    from daemon.studies.samples import DAYS, LICENCE, SITE, sample

    sources = [*map(sample, DAYS), LICENCE]
    check_output(out, [source.name for source in sources], "--out", force=force)
    for source in sources:
        shutil.copyfile(source, out / source.name)
    say(f"written to {out}: {', '.join(source.name for source in sources)}")
    say(f"SIMULATED; site {SITE.latitude_deg:g},{SITE.longitude_deg:g},{SITE.altitude_m:g}; free to use (CC0-1.0)")
