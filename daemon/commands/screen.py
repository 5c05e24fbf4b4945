"""The service's state as a person reads it at a glance."""

from collections.abc import Iterator
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

_MODE_STYLES = {
    "tracking": "bold green",
    "night": "bold blue",
    "fallback": "bold yellow",
    "stow": "bold magenta",
    "fault": "bold red",
    "snow": "bold cyan",
    "maintenance": "bold yellow",
}
_NEWS = 5
_BAD = "bold red"


def render(state: dict[str, Any]) -> RenderableType:
    """Return one screen for the JSON of /api/state."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column()
    for name, text in _rows(state):
        grid.add_row(name, text)
    news = [Text(f"{_clock(item['time'])}  {item['text']}", style="dim") for item in (state["news"] or [])[-_NEWS:]]
    return Group(_title(state), grid, *([Text(), *news] if news else []))


def _title(state: dict[str, Any]) -> Text:
    simulated = ("SIMULATED ", "bold yellow") if state["simulated"] else ""
    pace = f", {state['speed']:g} x real time" if state["speed"] != 1 else ""
    return Text.assemble(("heliocube ", "bold"), simulated, f"{state['role']} at {state['site']['name']}{pace}")


def _rows(state: dict[str, Any]) -> Iterator[tuple[str, Text]]:
    time, sun_deg = state["time"], state["sun_elevation_deg"]
    yield "time", Text(f"{time[:10]} {_clock(time)} UTC, sun at {_number(sun_deg, '.1f')} deg")
    if state["mode"] is not None:
        mode = state["mode"]
        style = _MODE_STYLES.get(mode["name"], "bold")
        yield "mode", Text.assemble((mode["name"], style), f" since {_clock(mode['since'])}: {mode['why']}")
    for alarm in state["alarms"]:
        yield "alarm", Text(f"{alarm['text']}  {_since(alarm['since'], time)}", style=_BAD)
    yield from _wishes(state)
    if state["tracker"] is not None:
        yield "tracker", _tracker(state["tracker"])
        yield from _target(state)
    if state["load"] is not None:
        yield "module", _module(state["load"])
    yield from _cube(state)
    if state["calibration"] is not None:
        yield "calibration", _calibration(state["calibration"])
    if state["bridge"] is not None:
        counts = state["bridge"]
        yield "bridge", Text(f"{counts['accepted']} scans accepted, {counts['lost']} lost, {counts['refused']} refused")
    if state["store"] is not None:
        yield "store", _store(state["store"])
    if state["mqtt"] is not None:
        yield from _mqtt(state["mqtt"], time)


def _wishes(state: dict[str, Any]) -> Iterator[tuple[str, Text]]:
    """Yield what persons asked for and is in force, each with its person and beginning."""
    for name, wish in (state["wishes"] or {}).items():
        if wish is not None:
            by = f" by {wish['by']}" if wish["by"] else ""
            since = "" if wish["since"] is None else f" {_since(wish['since'], state['time'])}"
            yield name, Text(f"{by}{since}: {wish['why']}".strip())


def _tracker(tracker: dict[str, Any]) -> Text:
    pose = tracker["pose"]
    if pose is None:
        return Text(tracker["down_why"] or "no telemetry yet", style=_BAD)
    text = Text(f"A {_number(pose['a_deg'], '+.1f')}, B {_number(pose['b_deg'], '.1f')} deg")
    if tracker["homing"]:
        text.append(", homing")
    elif tracker["target"] is not None:
        text.append(f", moving to A {tracker['target']['a_deg']:+.1f}, B {tracker['target']['b_deg']:.1f} deg")
    currents = [_number(tracker["motor_current_a"][axis], ".2f") for axis in ("a", "b")]
    if currents != ["-", "-"]:
        text.append(f", motors {currents[0]} and {currents[1]} A")
    if pose["stale"]:
        text.append(f"  STALE, {_age(pose['age_s'])} old", style=_BAD)
    for why in (tracker["down_why"], tracker["blocked_why"], tracker["doubt_why"]):
        if why:
            text.append(f"  {why}", style=_BAD)
            break
    return text


def _module(load: dict[str, Any]) -> Text:
    if load["down_why"]:
        return Text(load["down_why"], style=_BAD)
    curve = load["curve"]
    if curve is None:
        return Text("no curve yet")
    text = Text(
        f"{_number(curve['pmpp_w'], '.1f')} W at {_number(curve['vmpp_v'], '.2f')} V, {_age(curve['age_s'])} old"
    )
    if curve["quality"] != "ok":
        text.append(f"  {curve['quality']}: {curve['why']}", style="yellow")
    return text


def _target(state: dict[str, Any]) -> Iterator[tuple[str, Text]]:
    decision, next_s = state["decision"], state["next_decision_s"]
    if decision is None or next_s is None:
        return
    where = f"A {_number(decision['target_a_deg'], '+.1f')}, B {_number(decision['target_b_deg'], '.1f')} deg"
    yield "target", Text(f"{where} by {decision['law']}; next in {next_s:.0f} s")


def _cube(state: dict[str, Any]) -> Iterator[tuple[str, Text]]:
    if state["cube_down_why"]:
        yield "cube", Text(state["cube_down_why"], style=_BAD)
    scan = state["scan"]
    if scan is None:
        yield "scan", Text("none yet", style="" if state["cube_down_why"] else "yellow")
        return
    text = Text(f"{_age(scan['age_s'])} old, number {scan['sequence']} of {scan['source']}")
    if scan["stale"]:
        text.append("  STALE", style=_BAD)
    yield "scan", text
    for name, face in scan["faces"].items():
        good = face["quality"] == "ok"
        value = Text(f"{_number(face['irradiance_w_m2'], '7.1f')} W/m2", style="" if good else "dim")
        yield f"  {name}", value if good else Text.assemble(value, (f"  {face['quality']}", _BAD))


def _calibration(calibration: dict[str, Any]) -> Text:
    when = f"{calibration['identifier']}, until {calibration['expires'][:10]}"
    if calibration["validity"] == "valid":
        return Text(when)
    verb = "EXPIRED" if calibration["validity"] == "expired" else "EXPIRES SOON"
    return Text.assemble((f"{verb} ", _BAD), f"{when}; calibrate the cube anew")


def _store(store: dict[str, Any]) -> Text:
    counts = f"{store['written']} records written, {store['waiting']} waiting"
    if store["lost"]:
        counts += f", {store['lost']} lost"
    if store["down_why"]:
        return Text.assemble(("cannot write: ", _BAD), (store["down_why"], _BAD), f"; {counts}")
    return Text(counts)


def _mqtt(link: dict[str, Any], now: str) -> Iterator[tuple[str, Text]]:
    since = _since(link["since"], now)
    if link["connected"]:
        text = Text(f"{link['broker']} {since}, {link['sent']} messages sent, {link['received']} received")
    else:
        text = Text.assemble((f"not connected {since}: {link['down_why']}", _BAD))
        text.append(f"; {link['waiting']} messages waiting")
    if link["dropped"]:
        text.append(f", {link['dropped']} dropped {_since(link['dropped_since'], now)}", style=_BAD)
    yield "mqtt", text
    for item in link["inputs"]:
        heard = Text("nothing heard yet") if item["age_s"] is None else Text(f"heard {_age(item['age_s'])} ago")
        heard.append(f" on {item['topic']}")
        if item["stowing"]:
            heard.append("  STOW", style="bold magenta")
        yield f"  {item['name']}", heard
    for sentence in link["troubles"]:
        yield "", Text(sentence, style=_BAD)


def _since(time: str, now: str) -> str:
    day = "" if time[:10] == now[:10] else f"{time[:10]} "
    return f"since {day}{_clock(time)}"


def _clock(time: str) -> str:
    return time[11:19]


def _age(age_s: float | None) -> str:
    if age_s is None:
        return "?"
    return f"{age_s:.1f} s" if age_s < 100 else f"{age_s / 60:.0f} min" if age_s < 6000 else f"{age_s / 3600:.0f} h"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
