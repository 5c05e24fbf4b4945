"""Rules between the keys of the bridge, the broker and the interfaces; each is written as in `daemon.config.rules`."""

from collections.abc import Iterator

from daemon.base.addresses import parse_address
from daemon.config.conflict import Conflict
from daemon.config.links import NotifySettings
from daemon.config.sections import Sections


def the_bridge_is_signed_or_not(settings: Sections) -> Iterator[Conflict]:
    """`bridge.insecure` and `bridge.key_file` exclude each other; beyond this machine one of the two is set."""
    bridge = settings.bridge
    if bridge.insecure and bridge.key_file is not None:
        reason = "contradicts bridge.key_file, which asks for signed scans; remove one of the two"
        yield Conflict("bridge.insecure", reason, ("bridge.key_file",))
    if bridge.insecure or bridge.key_file is not None:
        return
    if bridge.transport == "mqtt":
        reason = "reaches beyond this machine, so bridge.key_file must name a key (or bridge.insecure be true)"
        yield Conflict("bridge.transport", reason, ("bridge.key_file", "bridge.insecure"))
    addresses = {"bridge.listen": bridge.listen}
    addresses |= {f"bridge.send_to[{index}]": text for index, text in enumerate(bridge.send_to)}
    if bridge.multicast_group is not None:
        addresses["bridge.multicast_group"] = bridge.multicast_group
    for key, text in addresses.items():
        if not parse_address(text).ip.is_loopback:
            reason = "reaches beyond this machine, so bridge.key_file must name a key (or bridge.insecure be true)"
            yield Conflict(key, reason, ("bridge.key_file", "bridge.insecure"))
            return


def multicast_interface_has_group(settings: Sections) -> Iterator[Conflict]:
    """`bridge.multicast_interface` is allowed only with `bridge.multicast_group`."""
    if settings.bridge.multicast_interface is not None and settings.bridge.multicast_group is None:
        reason = "has no effect without bridge.multicast_group"
        yield Conflict("bridge.multicast_interface", reason, ("bridge.multicast_group",))


def mqtt_inputs_need_broker(settings: Sections) -> Iterator[Conflict]:
    """`bridge.transport = "mqtt"`, `mqtt.wind.topic` and `mqtt.safe.topic` need `mqtt.enabled`."""
    if settings.mqtt.enabled:
        return
    if settings.bridge.transport == "mqtt":
        yield Conflict("bridge.transport", "needs mqtt.enabled = true and a broker", ("mqtt.enabled",))
    for name in ("wind", "safe"):
        if getattr(settings.mqtt, name).topic is not None:
            reason = "protects nothing without mqtt.enabled = true"
            yield Conflict(f"mqtt.{name}.topic", reason, ("mqtt.enabled",))


def archive_needs_broker_and_store(settings: Sections) -> Iterator[Conflict]:
    """`mqtt.archive` needs `mqtt.enabled`, and on a simulated rig `store.directory`."""
    if settings.mqtt.archive and not settings.mqtt.enabled:
        yield Conflict("mqtt.archive", "needs mqtt.enabled = true and a broker", ("mqtt.enabled",))
    if settings.mqtt.archive and settings.store.directory is None and settings.instruments.kind != "real":
        reason = "needs store.directory: a simulated rig keeps no records, and none can be sent"
        yield Conflict("mqtt.archive", reason, ("store.directory",))


def certificate_files_need_tls(settings: Sections) -> Iterator[Conflict]:
    """Certificate files of `mqtt` need `mqtt.tls`, and a key needs its certificate."""
    mqtt = settings.mqtt
    for name in ("ca_file", "certificate_file", "certificate_key_file"):
        if getattr(mqtt, name) is not None and not mqtt.tls:
            yield Conflict(f"mqtt.{name}", "has no effect without mqtt.tls = true", ("mqtt.tls",))
    if mqtt.certificate_file is None and mqtt.certificate_key_file is not None:
        yield Conflict("mqtt.certificate_key_file", "needs mqtt.certificate_file", ("mqtt.certificate_file",))


def safe_and_unsafe_values_differ(settings: Sections) -> Iterator[Conflict]:
    """`mqtt.safe.safe` and `mqtt.safe.unsafe` are two different words."""
    if settings.mqtt.safe.safe == settings.mqtt.safe.unsafe:
        yield Conflict("mqtt.safe.unsafe", "must differ from mqtt.safe.safe", ("mqtt.safe.safe",))


def quiet_hours_have_both_ends(settings: Sections) -> Iterator[Conflict]:
    """`notify.quiet_from` and `notify.quiet_until` are set together, and differ."""
    yield from conflicts_of_quiet_hours(settings.notify)


def conflicts_of_quiet_hours(notify: NotifySettings) -> Iterator[Conflict]:
    """Yield what is wrong with quiet hours; a process that reads no other section uses it, too."""
    for name, other in (("quiet_from", "quiet_until"), ("quiet_until", "quiet_from")):
        if getattr(notify, name) is not None and getattr(notify, other) is None:
            yield Conflict(f"notify.{name}", f"needs notify.{other}", (f"notify.{other}",))
    if notify.quiet_from is not None and notify.quiet_from == notify.quiet_until:
        reason = "must differ from notify.quiet_from; leave out both for no quiet hours"
        yield Conflict("notify.quiet_until", reason, ("notify.quiet_from",))


def servers_have_own_ports(settings: Sections) -> Iterator[Conflict]:
    """`api.listen` and `sunspec.listen` differ where both are served."""
    api, sunspec = settings.api, settings.sunspec
    if not (api.enabled and sunspec.enabled):
        return
    one, other = parse_address(api.listen), parse_address(sunspec.listen)
    # An address that stands for all networks takes the port on each of them.
    all_of_one = one.ip.version == other.ip.version and (one.ip.is_unspecified or other.ip.is_unspecified)
    if one.port == other.port != 0 and (one.ip == other.ip or all_of_one):
        reason = f"is the port of api.listen ({api.listen}) already; each needs one of its own"
        yield Conflict("sunspec.listen", reason, ("api.listen",))


LINK_RULES = (
    the_bridge_is_signed_or_not,
    multicast_interface_has_group,
    mqtt_inputs_need_broker,
    archive_needs_broker_and_store,
    certificate_files_need_tls,
    safe_and_unsafe_values_differ,
    quiet_hours_have_both_ends,
    servers_have_own_ports,
)
