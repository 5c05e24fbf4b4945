"""Runs the fault campaign: ``python -m tests.campaign.run --seeds 20 --hours 4``.

Each seed is a schedule of faults and commands on the in-memory rig. A broken promise is printed with its seed; the seed
alone runs it again, and --reduce drops every event that it does not take. Ends with 1 if any promise was broken.
"""

import argparse
import statistics
import sys
import time
from collections import Counter
from pathlib import Path

from tests.campaign.campaign import reduce, run
from tests.campaign.doors import DOORS
from tests.campaign.faults import CannotDoError
from tests.campaign.schedule import Schedule, draw


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="how many")
    parser.add_argument("--from", type=int, default=1, dest="first", help="the first")
    parser.add_argument("--hours", type=float, default=3.0, help="of virtual time for each")
    parser.add_argument("--without", nargs="*", default=[], help="faults and commands that are left out")
    parser.add_argument("--door", choices=DOORS, default="direct", help="how commands are given")
    parser.add_argument("--schedule", type=Path, help="run this one file instead, as --reduce has written it")
    parser.add_argument("--show", action="store_true", help="print the whole schedule and the service's log")
    parser.add_argument("--reduce", type=Path, help="write the reduced schedule of the first failure here")
    chosen = parser.parse_args()
    try:
        sys.exit(_campaign(chosen))
    except CannotDoError as error:
        sys.exit(f"refused: {error}")


def _campaign(chosen):
    found, latencies_s, events, begun_s = Counter(), [], 0, time.monotonic()
    schedules = (
        [Schedule.of_json(chosen.schedule.read_text())]
        if chosen.schedule
        else [draw(seed, chosen.hours, chosen.without) for seed in range(chosen.first, chosen.first + chosen.seeds)]
    )
    for schedule in schedules:
        outcome = run(schedule, DOORS[chosen.door])
        events += len(schedule.events)
        latencies_s += outcome.stop_latencies_s
        if chosen.show:
            _show(schedule, outcome)
        for violation in outcome.violations:
            print(f"seed {schedule.seed}: {violation}", flush=True)
        found.update(outcome.promises)
        print(f"seed {schedule.seed} done, {time.monotonic() - begun_s:.0f} s", file=sys.stderr, flush=True)
        if outcome.violations and chosen.reduce:
            door = DOORS[chosen.door]
            reduced = reduce(schedule, {outcome.violations[0].promise}, lambda fewer: run(fewer, door))
            chosen.reduce.write_text(reduced.json())
            print(f"reduced to {len(reduced.events)} events:\n{reduced.text()}\n{chosen.reduce}", flush=True)
            return 1
    hours = sum(schedule.hours for schedule in schedules)
    took_s = time.monotonic() - begun_s
    print(f"{len(schedules)} schedules, {hours:g} h of virtual time, {events} events, {took_s:.0f} s")
    if latencies_s:
        print(
            f"{len(latencies_s)} stops in motion: median {statistics.median(latencies_s):.2f} s,"
            f" worst {max(latencies_s):.2f} s to standstill in truth (looked at every 0.1 s)"
        )
    for promise, count in found.most_common():
        print(f"{count} schedules break {promise}")
    return 1 if found else 0


def _show(schedule, outcome):
    print(schedule.text())
    for at_s, level, name, text in outcome.lines:
        print(f"{at_s:9.2f} s  {level} {name.removeprefix('heliocube.')}: {text}")
    print(f"moves {outcome.moves}, modes {dict(outcome.modes)}")


if __name__ == "__main__":
    main()
