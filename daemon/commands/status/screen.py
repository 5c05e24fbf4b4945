"""The service's state for people: at a glance, on a screen that changes in place, or as a line now and then.

All of it is made from the JSON of the state alone, wherever that comes from.
"""

from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.words import pluralise
from daemon.commands.status.light import lines_of_light
from daemon.commands.status.times import local_and_utc_time, local_date_and_time, localise_times, time_zone_text
from daemon.commands.status.wishes import lines_of_wishes, strip_wish_reasons

_MODE_STYLES = {
    "tracking": "bold green",
    "night": "bold blue",
    "fallback": "bold yellow",
    "stow": "bold magenta",
    "fault": "bold red",
    "snow": "bold cyan",
    "maintenance": "bold yellow",
}
# The mode of these is hold as well, but they are more than a hold.
_HELD = {"stop": "STOPPED", "buttons": "BUTTON PRESSED AT THE UNIT"}
_STOP_STYLE = "bold white on red"
_NEWS, _LIVE_NEWS = 5, 7
_BAD = "bold red"
_FRAME_LINES, _FRAME_COLUMNS = 2, 4
# With fewer lines, a heading would take the room of the news.
_LEAST_ROOM = 5
_BAR_WIDTH = 30
_FULL_BAR_W_M2 = 1200.0


def render(state: dict[str, Any]) -> RenderableType:
    """Return one screen for the JSON of /api/state."""
    state = localise_times(state, state["time"])
    return Group(_title(state), _body(state, bars=False), *_news(state, _NEWS))


def live_screen(state: dict[str, Any]) -> RenderableType:
    """Return the screen in a frame, with bars for the faces, to change in place."""
    return _Framed(state)


class _Framed:
    """A frame with as many of the latest news as the terminal has room for: a cut would remove the newest."""

    def __init__(self, state: dict[str, Any]) -> None:
        self._state = localise_times(state, state["time"])

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        body = _body(self._state, bars=True)
        inside = options.update(width=options.max_width - _FRAME_COLUMNS, height=None)
        room = console.height - _FRAME_LINES - len(console.render_lines(body, inside))
        choices = (Group(*_news(self._state, count, bare=room < _LEAST_ROOM)) for count in range(_LIVE_NEWS, 0, -1))
        news = next((some for some in choices if len(console.render_lines(some, inside)) <= room), Group())
        yield Panel(Group(body, news), title=_title(self._state), subtitle="Ctrl-C ends", expand=True)


def _body(state: dict[str, Any], *, bars: bool) -> RenderableType:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column()
    for name, text in _rows(state, bars=bars):
        grid.add_row(name, text)
    return grid


def _news(state: dict[str, Any], most: int, *, bare: bool = False) -> Iterator[RenderableType]:
    news = state["news"][-most:]
    if news:
        lines = Table.grid(padding=(0, 2))
        lines.add_column(style="dim", no_wrap=True)
        lines.add_column(style="dim")
        for item in news:
            lines.add_row(local_date_and_time(item["time"]), item["text"])
        if not bare:
            yield from (Text(), Text(f"What happened lately ({time_zone_text(state['time'])})", style="dim"))
        yield lines


def status_line(state: dict[str, Any]) -> str:
    """Return the line that is shown every few seconds where a screen cannot change in place."""
    parts = [f"{state['time'][:19]}Z"]
    if state["simulated"]:
        parts.append("SIMULATED")
    if state["scan"] is not None:
        parts.append(" ".join(_face(name, face) for name, face in state["scan"]["faces"].items()))
    for name, own in _trackers(state).items():
        of = f"{name}: " if name else ""
        parts += [
            f"{of}{_pose_text(own['tracker'])}{_stale(own['tracker'])}",
            f"{of}{own['mode']['name']}: {own['mode']['why']}",
        ]
    parts += [f"ALARM {_with_tracker_name(alarm['name'], alarm, state)}" for alarm in state["alarms"]]
    if state["cube_down_why"]:
        parts.append(state["cube_down_why"])
    return " | ".join(parts)


def _face(name: str, face: dict[str, Any]) -> str:
    worth = "" if face["quality"] == "ok" else f" {face['quality']}"
    return f"{name[0].upper()} {_number(face['irradiance_w_m2'], '.1f')}{worth}"


def _stale(tracker: dict[str, Any]) -> str:
    """Return a text on the age of a pose that is stale, to be put behind the pose; else nothing."""
    pose = tracker["pose"]
    return f"  STALE, {_age(pose['age_s'])} old" if pose is not None and pose["stale"] else ""


def _trackers(state: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each tracker's part of the state by its name; a single tracker has an empty name."""
    found: dict[str, dict[str, Any]] = state.get("trackers") or {}
    # With several trackers the top of the state has no tracker, even if only one of them is shown.
    return found if state["mode"] is None else {"": state}


def _title(state: dict[str, Any]) -> Text:
    simulated = ("SIMULATED ", "bold yellow") if state["simulated"] else ""
    pace = f", {state['speed']:g} x real time" if state["speed"] != 1 else ""
    where = f"{state['role']} at {state['site']['name']}{pace}"
    return Text.assemble(("heliocube ", "bold"), simulated, _own_name(state), where)


def _own_name(state: dict[str, Any]) -> str:
    """Return the configured name of a single tracker, which tells its screen from others, or nothing."""
    names = [*(state.get("trackers") or {})]
    return f"{names[0]}, " if len(names) == 1 and names != ["tracker"] else ""


def _rows(state: dict[str, Any], *, bars: bool) -> Iterator[tuple[str, Text]]:
    time, sun_deg = state["time"], state["sun_elevation_deg"]
    yield "time", Text(f"{local_and_utc_time(time)}, sun at {_number(sun_deg, '.1f')} deg")
    if bars and state["sky"] is not None:
        yield "sky", Text(state["sky"])
    trackers = _trackers(state)
    if "" in trackers:
        yield _mode(state, time)
    for alarm in state["alarms"]:
        style = "" if alarm["state"] == "acknowledged" else _BAD
        yield (
            "alarm",
            Text(f"{_with_tracker_name(alarm['text'], alarm, state)} ({alarm_state(alarm, state)})", style=style),
        )
        # A service of an earlier version sends no remedy.
        if alarm.get("remedy"):
            yield "  remedy", Text(alarm["remedy"].replace("`", "'"))
    for name, own in trackers.items():
        if name:
            yield name, Text()
            for label, text in (_mode(own, time, name), *_tracker_rows(own, time), *_mqtt(own, time)):
                yield f"  {label}", text
        else:
            yield from _tracker_rows(own, time)
    yield from _cube(state, bars=bars)
    if state["calibration"] is not None:
        yield "calibration", _calibration(state["calibration"])
    if state["bridge"] is not None:
        counts = state["bridge"]
        accepted = pluralise(counts["accepted"], "scan")
        if counts.get("down_why"):
            yield "bridge", Text(counts["down_why"], style=_BAD)
        yield "bridge", Text(f"{accepted} accepted, {counts['lost']} lost, {counts['refused']} refused")
    if state["store"] is not None:
        yield "store", _store(state["store"])
    yield from _mqtt(state, time)


def alarm_state(alarm: dict[str, Any], state: dict[str, Any]) -> str:
    """Return since when an alarm is on or over, and who has acknowledged it."""
    since = _since(alarm["since"], state["time"])
    if alarm["state"] == "cleared":
        remedy = f"acknowledge it with 'heliocube alarms ack {alarm['name']}'"
        ended = _since(alarm["cleared_at"], state["time"])
        return f"{since}; over {ended}: {with_tracker_option(remedy, _tracker_of_alarm(alarm, state))}"
    return f"{since}; acknowledged by {alarm['acknowledged_by']}" if alarm["state"] == "acknowledged" else since


def _with_tracker_name(text: str, alarm: dict[str, Any], state: dict[str, Any]) -> str:
    """Return a text of an alarm, with the tracker's name if there are several."""
    whose = _tracker_of_alarm(alarm, state)
    return text if whose is None else f"{whose}: {text}"


def _tracker_of_alarm(alarm: dict[str, Any], state: dict[str, Any]) -> str | None:
    found: str | None = alarm["tracker"]
    return found if state["mode"] is None else None


def _mode(own: dict[str, Any], time: str, tracker: str | None = None) -> tuple[str, Text]:
    mode = own["mode"]
    asked, by_itself = mode.get("asked"), _MODE_STYLES.get(mode["name"], "bold")
    text = Text.assemble((mode["name"], _STOP_STYLE if asked == "stop" else by_itself))
    if asked in _HELD:
        text.append(f" {_HELD[asked]}", style=_STOP_STYLE)
    if asked is None:
        return "mode", text.append(f" {_since(mode['since'], time)}: {mode['why']}")
    wish = own["wishes"][asked]
    # The mode begins anew at each restart and after each fault; the wish does not.
    text.append(f" {_since(wish['since'] or mode['since'], time)}")
    # Who asked, and why, has a line of its own. The rest of the mode's reason is shown here.
    more = strip_wish_reasons(mode["why"], wish)
    return "mode", text.append(with_tracker_option(f"{more}; ends with 'heliocube auto'", tracker))


def _tracker_rows(own: dict[str, Any], time: str) -> Iterator[tuple[str, Text]]:
    yield from lines_of_wishes(own, time)
    yield "tracker", _tracker(own["tracker"])
    # A service of an earlier version sends no details.
    if details := own["tracker"].get("details"):
        yield "details", Text(_printable(", ".join(_detail(*detail) for detail in details.items())))
    yield from _target(own)
    yield from lines_of_light(own, time)
    sources = own.get("wind") or ()
    for source in sources:
        yield "wind", _wind(source, several=len(sources) > 1)
    if own["load"] is not None:
        yield "module", _module(own["load"])


def _tracker(tracker: dict[str, Any]) -> Text:
    pose = tracker["pose"]
    if pose is None:
        return Text(tracker["down_why"] or "no telemetry yet", style=_BAD)
    text = Text(_pose_text(tracker))
    currents = [_number(tracker["motor_current_a"][axis], ".2f") for axis in ("a", "b")]
    if currents != ["-", "-"]:
        text.append(f", motors {currents[0]} and {currents[1]} A")
    text.append(_stale(tracker), style=_BAD)
    for why in (tracker["down_why"], tracker["blocked_why"], tracker["doubt_why"]):
        if why:
            text.append(f"  {why}", style=_BAD)
            break
    return text


def _wind(source: dict[str, Any], *, several: bool) -> Text:
    """Return the last reading of a source of stow, its threshold, and when it releases a stow."""
    threshold, release_s = source["stow_from_m_s"], source["release_in_s"]
    of = f"{source['name']}: " if several else ""
    measured = f"{of}{_number(source['speed_m_s'], '.1f')} m/s, stow from {_number(threshold, 'g')} m/s"
    value = source["name"] if threshold is None else measured
    text = Text(f"{value}, {'not heard yet' if source['age_s'] is None else _age(source['age_s']) + ' old'}")
    if source["why"]:
        text.append(f"  STOWS: {source['why']}", style=_BAD)
        text.append("" if release_s is None else f"; ends after {_age(release_s)} more of calm")
    return text


def _detail(name: str, value: str | float | None) -> str:
    return f"{name.replace('_', ' ')} {value if isinstance(value, str) else _number(value, 'g')}"


def _printable(text: str) -> str:
    """Return a device's own words without characters that would control the terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _pose_text(tracker: dict[str, Any]) -> str:
    pose, target = tracker["pose"], tracker["target"]
    if pose is None:
        return tracker["down_why"] or "no telemetry yet"
    where = f"A {_number(pose['a_deg'], '+.1f')}, B {_number(pose['b_deg'], '.1f')} deg"
    if tracker["homing"]:
        return f"{where}, homing"
    if target is not None:
        return f"{where}, moving to A {target['a_deg']:+z.1f}, B {target['b_deg']:.1f} deg"
    return where


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
    yield "target", Text(f"{_pair(decision)} by {decision['law']}; next in {next_s:.0f} s")
    yield "  because", Text(_reason(decision))
    # A service of an earlier version does not send it.
    coming = state.get("next_decision")
    if coming is not None:
        does = "would go to" if coming["moves"] else "would stay; aim"
        yield "  next", Text(f"in the present light it {does} {_pair(coming)}: {_reason(coming)}")


def _pair(decision: dict[str, Any]) -> str:
    return f"A {_number(decision['target_a_deg'], '+.1f')}, B {_number(decision['target_b_deg'], '.1f')} deg"


def _reason(decision: dict[str, Any]) -> str:
    """Return the reason of a decision without the law's name in front."""
    why: str = decision["why"]
    return why.removeprefix(f"{decision['law']}: ")


def _cube(state: dict[str, Any], *, bars: bool) -> Iterator[tuple[str, Text]]:
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
        bar = f" {_bar(face['irradiance_w_m2'])}" if bars else ""
        value = Text(f"{_number(face['irradiance_w_m2'], '7.1f')} W/m2{bar}", style="" if good else "dim")
        yield f"  {name}", value if good else Text.assemble(value, (f"  {face['quality']}", _BAD))


def _bar(irradiance_w_m2: float | None) -> str:
    share = min(max((irradiance_w_m2 or 0.0) / _FULL_BAR_W_M2, 0.0), 1.0)
    return "█" * round(share * _BAR_WIDTH)


def _calibration(calibration: dict[str, Any]) -> Text:
    when = f"{calibration['identifier']}, until {calibration['expires'][:10]}"
    if calibration["validity"] == "valid":
        return Text(when)
    verb = "EXPIRED" if calibration["validity"] == "expired" else "EXPIRES SOON"
    return Text.assemble((f"{verb} ", _BAD), f"{when}; calibrate the cube again")


def _store(store: dict[str, Any]) -> Text:
    counts = f"{pluralise(store['written'], 'record')} written, {store['waiting']} waiting"
    if store["lost"]:
        counts += f", {store['lost']} lost"
    if store["down_why"]:
        return Text.assemble(("cannot write: ", _BAD), (store["down_why"], _BAD), f"; {counts}")
    return Text(counts)


def _mqtt(state: dict[str, Any], now: str) -> Iterator[tuple[str, Text]]:
    link = state["mqtt"]
    if link is None:
        return
    since = _since(link["since"], now)
    if link["connected"]:
        text = Text(f"{link['broker']} {since}, {pluralise(link['sent'], 'message')} sent, {link['received']} received")
    else:
        text = Text.assemble((f"not connected {since}: {link['down_why']}", _BAD))
        text.append(f"; {pluralise(link['waiting'], 'message')} waiting")
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
    return f"since {local_and_utc_time(time, now)}"


def _age(age_s: float | None) -> str:
    if age_s is None:
        return "?"
    return f"{age_s:.1f} s" if age_s < 100 else f"{age_s / 60:.0f} min" if age_s < 6000 else f"{age_s / 3600:.0f} h"


def _number(value: float | None, form: str) -> str:
    if value is None:
        return "-"
    text = format(value, form)
    # No minus in front of zero.
    return format(0.0, form) if float(text) == 0.0 else text
