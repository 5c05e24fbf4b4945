"""The parts of the documentation site. `make docs` builds it, runs the notebook and checks every link."""

import importlib.util
import json
import re
import tomllib
from xml.etree import ElementTree as ET

import pytest

from daemon.base.alarms.kinds import KINDS
from daemon.base.records import Mode
from tests.support import DOCS


def script(path):
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


BUILD = script(DOCS / "site" / "build.py")


def test_the_menu_names_every_page_once(tmp_path):
    BUILD.stage(tmp_path / "pages")
    text = (DOCS / "site" / "zensical.toml").read_text()
    pages = {*BUILD.pages(tmp_path / "pages"), "tutorials/notebook.md"}
    assert BUILD.named(tomllib.loads(text)) == pages
    assert len(re.findall(r'"[\w/.-]+\.md"', text)) == len(pages)


def test_a_link_text_is_the_menu_title_of_its_page_and_not_a_file_name(tmp_path):
    BUILD.stage(tmp_path / "pages")
    texts = {page.name: page.read_text(encoding="utf-8") for page in (tmp_path / "pages").rglob("*.md")}
    assert "([Alarms](alarms.md))" in texts["dashboard.md"]
    assert [name for name, text in texts.items() if re.search(r"\[[\w/.-]+\.md\]\(", text)] == []


def test_every_decision_is_in_the_list_of_decisions():
    listed = re.findall(r"- \[.+\]\((.+)\)", BUILD.decisions())
    assert listed == [page.name for page in sorted((DOCS / "decisions").glob("0*.md"))]


def test_a_page_that_fetches_from_another_host_is_reported(tmp_path):
    (tmp_path / "own.html").write_text(f'<script src="{BUILD.SHIM}"></script><a href="https://sunspec.org">', "utf-8")
    (tmp_path / "other.html").write_text('<link rel="stylesheet" href="https://fonts.example/x.css">', "utf-8")
    assert BUILD.own_scripts(tmp_path) == ["other.html"]
    assert 'src="site/iframe-worker.js"' in (tmp_path / "own.html").read_text()
    assert (DOCS / "site" / "iframe-worker.js").is_file()


def test_the_404_page_finds_the_site_in_whatever_folder_the_site_is_served(tmp_path):
    (tmp_path / "tutorials").mkdir()
    page = '<head><link href="/site.css"></head><h1>404 - Not found</h1>{"search":"/s.js"}<script src="/assets/b.js">'
    (tmp_path / "404.html").write_text(page, encoding="utf-8")
    BUILD.at_home_anywhere(tmp_path)
    text = (tmp_path / "404.html").read_text(encoding="utf-8")
    assert '"/' not in text
    assert 'href="index.html"' in text
    assert text.index("<base") < text.index("site.css")
    (root,) = re.findall(r"match\(/(.+)/\)\[0\]", text)
    found = {
        path: re.match(root, path)[0] for path in ("/no.html", "/at/docs/no.html", "/at/docs/tutorials/far/no.html")
    }
    assert list(found.values()) == ["/", "/at/docs/", "/at/docs/"]


def test_the_site_search_treats_the_name_of_an_alarm_as_one_word():
    settings = tomllib.loads((DOCS / "site" / "zensical.toml").read_text(encoding="utf-8"))
    separator = settings["project"]["plugins"]["search"]["separator"]
    assert [name for name in KINDS if re.split(separator, name) != [name]] == []
    assert re.split(separator, "see [safety]: scan_stale_s=15.0") == ["see", "safety", "scan_stale_s", "15.0"]


def test_the_committed_drawing_of_the_angles_matches_what_its_script_draws():
    drawing = script(DOCS / "glossary_drawing.py")
    assert drawing.PICTURE.read_text(encoding="utf-8") == drawing.picture(), "run python docs/glossary_drawing.py"
    ET.fromstring(drawing.picture())


def test_the_tutorial_notebook_is_committed_without_outputs():
    cells = json.loads((DOCS / "tutorials" / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    assert not [cell["id"] for cell in cells if cell.get("outputs") or cell.get("execution_count")]


def test_the_service_in_the_tutorial_notebook_uses_no_fixed_port():
    cells = json.loads((DOCS / "tutorials" / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    (written,) = re.findall(r"settings = '(.+)'", "".join(line for cell in cells for line in cell["source"]))
    settings = tomllib.loads(written.replace("\\n", "\n"))
    assert settings["bridge"]["listen"].endswith(":0")
    assert settings["api"]["enabled"] is False


@pytest.mark.parametrize("word", [*Mode, "A", "B", "face", "stop", "scan", "target", "law"])
def test_the_glossary_has_the_words_of_the_status(word):
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    assert re.search(rf"^{word}\n:   |`{word}`", text, re.MULTILINE)
