"""The energy study of many site-years by one process, by several and by a cluster: wall times, and whether bytes agree.

Usage: python tests/measurements/site_years.py [SITE_YEARS [JOBS [HOST:PORT of a dask scheduler]]]
       python tests/measurements/site_years.py days [SITES]

Sites lie on a grid between 45 deg south and 60 deg north, each under the built-in weather `broken`; 64 by default.
Needs as many idle cores as there are jobs. `days` runs SITES sites, a thousand by default, with one day of light each
in one process, and prints its processor time and memory: other load on the machine does not change these.
"""

import csv
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LAWS = "mu-prime,optimal,bound"
DAY_LAWS = "flat,mu-prime"
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


def many_days(sites: str = "1000") -> None:
    """Run the study of many sites with one measured day each."""
    with tempfile.TemporaryDirectory() as folder:
        light = [(minute, max(0, 700 - abs(minute - 720) * 2)) for minute in range(0, 1440, 5)]
        rows = [
            f"2016-06-05T{minute // 60:02d}:{minute % 60:02d}:00Z,{150 + dni / 2},{dni},150" for minute, dni in light
        ]
        Path(folder, "day.csv").write_text("\n".join(["time,ghi,dni,dhi", *rows]), encoding="utf-8")
        lines = [f"site {number},{-50 + 100 * number / int(sites):.4f},0,day.csv" for number in range(int(sites))]
        table = Path(folder, "sites.csv")
        table.write_text("\n".join(["name,latitude,longitude,weather", *lines]), encoding="utf-8")
        command = [str(Path(sys.executable).with_name("heliocube")), "energy", "--sites", str(table), "--out", folder]
        subprocess.run([*command, "--laws", DAY_LAWS], check=True, capture_output=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{sites} sites of one day, laws {DAY_LAWS}: {used.ru_utime + used.ru_stime:.0f} s of a processor,"
          f" {used.ru_maxrss / 1024:.0f} MB")  # fmt: skip


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
    if sys.argv[1:2] == ["days"]:
        many_days(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
