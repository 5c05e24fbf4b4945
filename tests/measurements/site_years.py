"""The energy study of many site-years by one process, by several and by a cluster: wall times, and whether bytes agree.

Usage: python tests/measurements/site_years.py [SITE_YEARS [JOBS [HOST:PORT of a dask scheduler]]]

Sites lie on a grid between 45 deg south and 60 deg north, each under the built-in weather `broken`; 64 by default.
Needs as many idle cores as there are jobs.
"""

import csv
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LAWS = "mu-prime,optimal,bound"
YEARS = (2020, 2021, 2022, 2023)


def write_table(path: Path, lines: int) -> None:
    """Write the sites, four years of each."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "latitude", "longitude", "weather", "year"])
        for number in range(lines):
            site, year = divmod(number, len(YEARS))
            place = (-45 + 35 * (site % 4), -120 + 60 * (site // 4 % 5) + site // 20)
            writer.writerow([f"site {site}", *place, "broken", YEARS[year]])


def main(lines: str = "64", jobs: str = "2", cluster: str = "") -> None:
    """Run the study each way and print what it took."""
    heliocube = str(Path(sys.executable).with_name("heliocube"))
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()},"
          f" load {os.getloadavg()[0]:.1f} before; {lines} site-years, laws {LAWS}")  # fmt: skip
    ways = {"one process": [], f"--jobs {jobs}": ["--jobs", jobs]}
    if cluster:
        ways[f"--cluster {cluster}"] = ["--cluster", cluster]
    with tempfile.TemporaryDirectory() as folder:
        table, alone_s, first = Path(folder, "sites.csv"), 0.0, {}
        write_table(table, int(lines))
        for number, (name, words) in enumerate(ways.items()):
            out = Path(folder, str(number))
            command = [heliocube, "energy", "--sites", str(table), "--out", str(out), "--laws", LAWS, *words]
            started = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            took_s = time.perf_counter() - started
            written = {path.name: path.read_bytes() for path in sorted(out.iterdir())}
            alone_s, first = alone_s or took_s, first or written
            print(f"{name}: {took_s:.1f} s, {took_s / int(lines):.2f} s a site-year, {alone_s / took_s:.2f} times as"
                  f" fast, {'the same bytes' if written == first else 'OTHER BYTES'}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
