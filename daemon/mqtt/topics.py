"""The names of topics, and which texts can be one."""

from dataclasses import dataclass

_LONGEST = 200


def check_topic(text: str) -> str:
    """Return `text` if it is a topic to publish on or to listen to: no wildcard, no empty level.

    Raises
    ------
    ValueError
        In one sentence.
    """
    if "+" in text or "#" in text:
        raise ValueError(f"{text!r} has a wildcard, and a topic has none")
    if not 0 < len(text) <= _LONGEST or not text.isprintable():
        raise ValueError(f"{text!r} is not one line of 1 to {_LONGEST} letters")
    if not all(text.split("/")) or text.startswith("$"):
        raise ValueError(f"{text!r} has an empty level, or begins with $")
    return text


def check_level(text: str) -> str:
    """Return `text` if it is one level of a topic; raises `ValueError` in one sentence."""
    if "/" in check_topic(text):
        raise ValueError(f"{text!r} is more than one level of a topic")
    return text


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one process.

    Attributes
    ----------
    prefix
        One for the installation.
    name
        One level for this tracker, or this cube.
    """

    prefix: str
    name: str

    @property
    def base(self) -> str:
        """What all topics of this process begin with."""
        return f"{self.prefix}/{self.name}"

    @property
    def status(self) -> str:
        """Availability: ``online`` or ``offline``, retained."""
        return self.of("status")

    @property
    def state(self) -> str:
        """The whole state, retained."""
        return self.of("state")

    @property
    def reply(self) -> str:
        """What came of commands."""
        return self.of("reply")

    def command(self, name: str) -> str:
        """Return the topic on which one command is taken."""
        return self.of(f"command/{name}")

    def of(self, kind: str) -> str:
        """Return the topic of one kind of record."""
        return f"{self.base}/{kind}"
