"""A qemu machine with a kernel of its own, for lines of a unit that no container here enforces."""

import contextlib
import json
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from boot import probes
from boot.host import ROOT, CheckFailed, CheckSkipped, run

TOOLS = {"qemu-system-x86_64": "qemu-system-x86", "cpio": "cpio", "apt-get": "apt", "dpkg-deb": "dpkg"}
KERNEL = "linux-image-cloud-amd64"
"""Debian's package for emulated machines; the package that it depends on is the kernel itself."""

_REFUSED = "Operation not permitted"
# Folders that no probe reads, and that would only take memory.
_UNREAD = ("usr/share/doc", "usr/share/locale", "usr/share/man", "usr/share/python-wheels", "var/cache", "var/lib/apt")

Answers = dict[str, dict[str, dict[str, object]]]
"""By unit, and by the beginning of the lines that the unit was without."""


class EmulatedMachine:
    """A Debian of the cache, started once under qemu with copies of the units; their program tries what is refused.

    Parameters
    ----------
    cache
        Where the kernel and the Debian as an archive are kept from run to run.
    base
        The folder with the Debian.
    """

    def __init__(self, cache: Path, base: Path) -> None:
        self._cache = cache
        self._base = base
        self._answers: Answers = {}
        self._failed: CheckSkipped | CheckFailed | None = None

    def prepare(self) -> str:
        """Fetch and pack what the machine is started from, unless it is kept; whether it is needed shows later."""
        _need_tools()
        with self._folder() as work:
            return f"{self._kernel(work).name} and {self._archive(work).name}"

    def check_addresses(self, units: Mapping[str, str]) -> str:
        """See that units neither send to a foreign address nor hear one, and do both without their lines `IPAddress`.

        Parameters
        ----------
        units
            Text by name.
        """
        for unit, answers in self._look(units).items():
            whole, without = answers[""], answers[probes.ADDRESSES]
            heard = whole["heard"]
            if whole["foreign"] != _REFUSED:
                raise CheckFailed(f"{unit} sends to {probes.FOREIGN}: {whole['foreign']}; hears {heard}")
            if (whole["own"], heard) != ("allowed", [probes.OWN]):
                raise CheckFailed(f"{unit} hears {heard}, and not {probes.OWN} alone; sends to that: {whole['own']}")
            if (without["foreign"], without["heard"]) != ("allowed", [probes.OWN, probes.FOREIGN]):
                raise CheckFailed(f"{unit} without IPAddressDeny is refused it as well: {without}")
        return (
            f"sending to {probes.FOREIGN}: {_REFUSED}, nothing is heard from there, {probes.OWN} is reached and heard;"
            f" without IPAddressDeny both are; {_names(units)}"
        )

    def check_devices(self, units: Mapping[str, str]) -> str:
        """See that units do not open a device that everybody may, and open it without their lines `Device`."""
        for unit, answers in self._look(units).items():
            whole, without = answers[""], answers[probes.DEVICES]
            if whole["device"] != _REFUSED:
                raise CheckFailed(f"{unit} opens {probes.DEVICE}, which everybody may: {whole['device']}")
            if without["device"] != "allowed":
                raise CheckFailed(
                    f"{unit} without DevicePolicy is refused {probes.DEVICE} as well: {without['device']}"
                )
        return f"opening {probes.DEVICE}: {_REFUSED}; without DevicePolicy it is allowed; {_names(units)}"

    def _look(self, units: Mapping[str, str]) -> Answers:
        """Start the machine the first time; return its answers of then, or raise its error of then."""
        if self._failed is None and not self._answers:
            try:
                self._answers = self._start(units)
            except (CheckSkipped, CheckFailed) as error:
                self._failed = error
        if self._failed is not None:
            raise self._failed
        return self._answers

    def _start(self, units: Mapping[str, str]) -> Answers:
        _need_tools()
        with self._folder() as work:
            console, image = work / "console", work / "image"
            kernel = self._kernel(work)
            # The kernel unpacks one archive after the other.
            shutil.copyfile(self._archive(work), image)
            _pack(_guest(work / "guest", units), image)
            ended = "ended"
            try:
                run(*_qemu(kernel, image, console))
            except CheckFailed as error:
                ended = str(error)
            return _read(console, ended)

    @contextlib.contextmanager
    def _folder(self) -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="emulated-", dir=self._cache) as name:
            yield Path(name)

    def _kernel(self, work: Path) -> Path:
        """Return Debian's kernel, fetched with this machine's apt the first time."""
        kernel = self._cache / f"vmlinuz-{KERNEL}"
        if kernel.exists():
            return kernel
        try:
            _fetch_kernel(work)
        except CheckFailed as error:
            raise CheckSkipped(f"no kernel for qemu can be had here: {' / '.join(str(error).splitlines())}") from None
        (found,) = work.glob("boot/vmlinuz-*")
        return found.rename(kernel)

    def _archive(self, work: Path) -> Path:
        """Return the Debian as an archive of the form that a kernel unpacks into its memory."""
        archive = self._cache / f"{self._base.name}.cpio"
        if not archive.exists():
            _pack(self._base, work / "debian", _UNREAD)
            (work / "debian").rename(archive)
        return archive


def _fetch_kernel(folder: Path) -> None:
    """Fetch the kernel's package and unpack it in a folder."""
    named = re.search(r"Depends: (linux-image-\S+)", run("apt-cache", "depends", KERNEL))
    if named is None:
        raise CheckFailed(f"apt knows of no kernel that {KERNEL} depends on")
    run("apt-get", "--quiet", "download", named[1], cwd=folder)
    (package,) = folder.glob("*.deb")
    run("dpkg-deb", "--extract", package, folder)


def _need_tools() -> None:
    if platform.machine() != "x86_64":
        raise CheckSkipped(f"this machine is {platform.machine()}, and qemu is tried with a kernel for amd64 only")
    missing = sorted({package for tool, package in TOOLS.items() if shutil.which(tool) is None})
    if missing:
        raise CheckSkipped(f"qemu needs what is not installed: apt-get install {' '.join(missing)}")


def _pack(folder: Path, archive: Path, unread: tuple[str, ...] = ()) -> None:
    """Add what lies in a folder to the end of an archive."""
    leave = [word for name in unread for word in ("-path", f"./{name}", "-prune", "-o")]
    pack = 'out=$1; shift; find . -xdev -mindepth 1 "$@" -print0 | cpio --quiet --null --create --format=newc >>"$out"'
    run("sh", "-c", pack, "sh", archive, *leave, cwd=folder)


def _guest(folder: Path, units: Mapping[str, str]) -> Path:
    """Write the files that the Debian lacks, and return the folder."""
    names = {unit: {without: _name(unit, without) for without in probes.OMITTED_LINE_PREFIXES} for unit in units}
    files = {
        "etc/machine-id": "0123456789abcdef0123456789abcdef\n",
        "etc/sysusers.d/heliocube.conf": (ROOT / "deploy/heliocube.sysusers.conf").read_text(encoding="utf-8"),
        "etc/systemd/system/probe.target": probes.TARGET,
        "etc/systemd/system/probe.service": probes.SERVICE,
        "opt/guest.py": probes.guest_program(names),
        "opt/probe.py": probes.PROBE,
    }
    for unit, text in units.items():
        for condition in re.findall(r"(?m)^ConditionPathExists=/(.+)$", text):
            files[condition] = ""
        for without, name in names[unit].items():
            lines = [line for line in text.splitlines() if not (without and line.startswith(without))]
            files[f"etc/systemd/system/{name}"] = "\n".join(lines) + "\n"
            files[f"etc/systemd/system/{name}.d/probe.conf"] = probes.DROP_IN
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    for path in folder.rglob("*"):
        path.chmod(0o755)
    return folder


def _name(unit: str, without: str) -> str:
    return f"{unit.removesuffix('.service')}-without-{without}.service" if without else unit


def _qemu(kernel: Path, image: Path, console: Path) -> tuple[object, ...]:
    """Return the command: without network and disk, with a console and one more serial line that leads nowhere."""
    words = "console=ttyS0 rdinit=/sbin/init systemd.unit=probe.target systemd.firstboot=no systemd.show_status=no"
    return (
        *("qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1536"),
        *("-nodefaults", "-no-user-config", "-display", "none", "-nic", "none", "-no-reboot"),
        *("-serial", f"file:{console}", "-serial", "null"),
        *("-kernel", kernel, "-initrd", image, "-append", f"{words} quiet panic=-1"),
    )


def _read(console: Path, ended: str) -> Answers:
    """Return what the guest has said on its console; `CheckSkipped` where no guest has come as far as that."""
    text = console.read_text(encoding="utf-8", errors="replace") if console.exists() else ""
    said = " / ".join(line.strip() for line in text.splitlines()[-3:])
    if f"{probes.MARK}begun" not in text:
        raise CheckSkipped(f"no machine boots under qemu here ({ended}): {said}")
    if (found := re.search(re.escape(probes.MARK) + r"(\{.*\})", text)) is None:
        raise CheckFailed(f"the machine under qemu {ended} without an answer: {said}")
    answers: Answers = json.loads(found[1])
    for unit, by_lines in answers.items():
        for without, answer in by_lines.items():
            if "error" in answer:
                raise CheckFailed(f"{_name(unit, without)} does not run under qemu: {answer['error']}")
    return answers


def _names(units: Mapping[str, str]) -> str:
    return " and ".join(unit.removesuffix(".service") for unit in units)
