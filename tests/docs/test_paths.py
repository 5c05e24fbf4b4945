"""What the pages point at is there: files and modules of this repository, and other pages."""

import re
from urllib.parse import urlsplit

import pytest

from tests.support import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
OURS = "solar|drivers|sim_drivers|daemon|tests|deploy|docs"
PATH = re.compile(rf"`((?:{OURS}|heliocube)/[\w./-]*)`")
MODULE = re.compile(rf"`((?:{OURS})(?:\.\w+)+)`")
LINK = re.compile(r"\]\((?!https?:|#)([^)#]+)")
FOREIGN = re.compile(r"(?:\]\(|<)(https?:[^)>\n]*)[)>]")
# Where campaigns put what failed.
ELSEWHERE = {"tests/campaign/failed_once/"}
# This decision tells of names that were tried and not taken.
NOT_TAKEN = "0001-import-names-are-folder-names.md"


def module(name):
    """Return whether a dotted name is a module of ours, or something in one."""
    inner = ROOT.joinpath(*name.split("."))
    files = (inner, inner.parent, inner.parent.parent)
    return inner.is_dir() or any(file.with_suffix(".py").is_file() for file in files if file != ROOT)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_path_module_and_link_that_a_page_names_exists(page):
    text = page.read_text()
    missing = []
    if page.name != NOT_TAKEN:
        missing += [path for path in PATH.findall(text) if not (ROOT / path).exists()]
        missing += [name for name in MODULE.findall(text) if not module(name)]
    missing += [link for link in LINK.findall(text) if not (page.parent / link).exists()]
    assert not set(missing) - ELSEWHERE


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_external_links_of_a_page_are_well_formed(page):
    for address in FOREIGN.findall(page.read_text()):
        parts = urlsplit(address)
        assert re.fullmatch(r"[\w.-]+\.[a-z]{2,}|127\.0\.0\.1|tracker\.lab", parts.hostname or ""), address
        assert not re.search(r"\s|[.,;]$", address), address


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_run_as_the_service_user_name_the_configuration_file(page):
    # sudo does not hand HELIOCUBE_CONFIG on; a store is salvaged without one.
    commands = re.findall(r"sudo -u heliocube heliocube (?!store )([^`\n]*)", page.read_text())
    assert [command for command in commands if "/etc/heliocube/" not in command and "..." not in command] == []
