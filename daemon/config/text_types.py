"""The texts of the settings that have a form of their own: addresses, hosts, times of the day, topics."""

import ipaddress
import re
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator

from daemon.base.addresses import parse_address
from daemon.config.database import check_database_hosts
from drivers.settings import check_host, text_schema

_CLOCK_TIME = re.compile(r"([01]\d|2[0-3]):[0-5]\d")
_WEB = re.compile(r"https?://[^\s/]\S*")
# No colon is allowed before the @: it would divide a user from a password.
_ARCHIVE = re.compile(r"postgres(ql)?://([^:@/\s#]+@)?[^@/?\s#]*/[^/?\s#]+(\?[^\s#]*)?")
_TOPICS = re.compile(r"([^/#+$\s]+|\+)(/([^/#+\s]+|\+))+/records")
_ALL_OF_THIS_NETWORK = "255.255.255.255"
_HOST_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9.:-]{0,252}")


def _listen_address(text: str) -> str:
    parse_address(text)
    return text


def _send_address(text: str) -> str:
    if parse_address(text).port == 0:
        raise ValueError("port 0 is nobody's")
    return text


def _tracker_address(text: str) -> str:
    address = parse_address(_send_address(text))
    if address.ip.is_unspecified or address.host == _ALL_OF_THIS_NETWORK:
        raise ValueError("no one machine's")
    return text


def _group(text: str) -> str:
    group = parse_address(text)
    if not (group.ip.version == 4 and group.ip.is_multicast and group.port):
        raise ValueError("not an IPv4 multicast group")
    return text


def _host(text: str) -> str:
    ipaddress.ip_address(text)
    return text


def _interface(text: str) -> str:
    ipaddress.IPv4Address(text)
    return text


def _clock_time(text: str) -> str:
    if not _CLOCK_TIME.fullmatch(text):
        raise ValueError("not a time of the day")
    return text


def _web(text: str) -> str:
    if not _WEB.fullmatch(text):
        raise ValueError("not a web address")
    check_host(urlsplit(text).hostname or "")
    return text


def _archive(text: str) -> str:
    if not _ARCHIVE.fullmatch(text):
        raise ValueError("not an address of a database without a password")
    check_database_hosts(text)
    return text


def _topics(text: str) -> str:
    if not _TOPICS.fullmatch(text):
        raise ValueError("not a filter of topics that ends in /records")
    return text


def _host_name(text: str) -> str:
    if not _HOST_NAME.fullmatch(text):
        raise ValueError("not a host")
    check_host(text)
    return text


ListenAddress = Annotated[str, AfterValidator(_listen_address), text_schema("listen")]
SendAddress = Annotated[str, AfterValidator(_send_address), text_schema("address")]
TrackerAddress = Annotated[str, AfterValidator(_tracker_address), text_schema("tracker")]
Group = Annotated[str, AfterValidator(_group), text_schema("group")]
IpAddress = Annotated[str, AfterValidator(_host), text_schema("ip")]
Interface = Annotated[str, AfterValidator(_interface), text_schema("ipv4")]
# daemon.mqtt.topics tells whether these three can be used: a wrong one must not keep the tracker from tracking.
Topic = Annotated[str, text_schema("topic")]
TopicLevel = Annotated[str, text_schema("level")]
JsonPath = Annotated[str, text_schema("json-path")]
ClockTime = Annotated[str, AfterValidator(_clock_time), text_schema("clock-time")]
WebAddress = Annotated[str, AfterValidator(_web), text_schema("web")]
ArchiveUrl = Annotated[str, AfterValidator(_archive), text_schema("archive")]
TopicFilter = Annotated[str, AfterValidator(_topics), text_schema("records")]
HostName = Annotated[str, AfterValidator(_host_name), text_schema("host")]
