"""Builds the documentation site: the pages of this repository, the notebook as it runs today, a list of the decisions.

``python docs/site/build.py`` leaves site/html; `make docs` installs what it needs first. It needs no network, and ends
with an error for a link that leads nowhere, a page in no menu, or a cell of the notebook that fails.
"""

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DOCS = ROOT / "docs"
# Pages that stand where people look for them in a repository, and their names on the site.
BESIDE = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
# The kernel's errors only: it warns of the other users of this machine, who could listen to it.
NOTEBOOK = (
    "nbconvert --execute --to markdown --log-level WARN "
    "--ExecutePreprocessor.extra_arguments=--IPKernelApp.log_level=40 --output-dir pages/tutorials "
    "../docs/tutorials/notebook.ipynb"
)
ZENSICAL = "zensical build --strict --clean"
# A server gives the page of a wrong address under that address, in whatever folder the site lies: it has to look there
# for the first of the site's own folders itself.
LOST = "404.html"
BEGIN = """<script>{
  const root = location.pathname.match(/^.*?\\/(?=(?:FOLDERS)\\/)|^.*\\//)[0];
  document.head.insertAdjacentHTML("afterbegin", `<base href="${root}">`);
}</script>"""
BEGIN_OF_SEARCH = """<script>{
  const settings = document.getElementById("__config");
  settings.textContent = JSON.stringify({ ...JSON.parse(settings.textContent), base: document.baseURI });
}</script>"""
LOST_WORDS = """
  <h1>There is no such page</h1>
  <p>Search for what you are after, or begin at <a href="index.html">the front page</a>.</p>"""
# What Zensical's pages ask of the network.
SHIM = "https://unpkg.com/iframe-worker/shim"
DECISIONS_HEAD = """# Decisions

Choices that somebody may want to undo one day: the context, what was tried, what was taken, and what it costs.

"""


def main() -> int:
    """Build the site; the exit code is that of the first step that fails."""
    site = ROOT / "site"
    shutil.rmtree(site, ignore_errors=True)
    stage(site / "pages")
    shutil.copy(HERE / "zensical.toml", site)
    for step in (NOTEBOOK, ZENSICAL):
        done = subprocess.run([sys.executable, "-m", *step.split()], cwd=site, check=False)  # noqa: S603 - our own words
        if done.returncode:
            return done.returncode
        if step == NOTEBOOK:
            plain_tables(site / "pages" / "tutorials" / "notebook.md")
    menu = named(tomllib.loads((site / "zensical.toml").read_text(encoding="utf-8")))
    at_home_anywhere(site / "html")
    asking = own_scripts(site / "html")
    if asking:
        print(f"asks something of the network: {', '.join(asking)}", file=sys.stderr)
        return 1
    missing = [page for page in pages(site / "pages") if page not in menu]
    if missing:
        print(f"in no menu of docs/site/zensical.toml: {', '.join(missing)}", file=sys.stderr)
        return 1
    print(f"written: {(site / 'html' / 'index.html').relative_to(ROOT)}")
    return 0


def stage(folder: Path) -> None:
    """Copy every page and picture to `folder`, with links that hold and read well there."""
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("*.py", "*.ipynb", "zensical.toml", "__pycache__"))
    for source, name in BESIDE.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        (folder / name).write_text(re.sub(r"\]\(docs/", "](", text), encoding="utf-8")
    menu = (HERE / "zensical.toml").read_text(encoding="utf-8")
    titles = {Path(page).name: title for title, page in re.findall(r'"([^"]+)" = "([^"]+\.md)"', menu)}
    for page in folder.rglob("*.md"):
        text = re.sub(r"\]\(((?:\.\./)*decisions/)\)", r"](\1index.md)", page.read_text(encoding="utf-8"))
        # In a repository a page is known by its file, on the site by its place in the menu.
        text = re.sub(r"\[(?:docs/)?([\w-]+\.md)\](?=\()", lambda found: f"[{titles[found[1]]}]", text)
        page.write_text(text.replace("notebook.ipynb)", "notebook.md)"), encoding="utf-8")
    (folder / "decisions" / "index.md").write_text(decisions(), encoding="utf-8")


def decisions() -> str:
    """Return the page that lists the decisions, by the headings of their pages."""
    found = sorted((DOCS / "decisions").glob("0*.md"))
    titles = (page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for page in found)
    return DECISIONS_HEAD + "".join(
        f"- [{title.replace('. ', ' · ', 1)}]({page.name})\n" for page, title in zip(found, titles, strict=True)
    )


def plain_tables(page: Path) -> None:
    """Let the tables of a notebook look like all others of the site."""
    text = re.sub(r"<style scoped>.*?</style>\n?", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    page.write_text(text.replace('<table border="1" class="dataframe">', "<table>"), encoding="utf-8")


def at_home_anywhere(html: Path) -> None:
    """Let the page of a wrong address find the site, wherever it lies, and say what to do."""
    folders = "|".join(sorted(path.name for path in html.iterdir() if path.is_dir()))
    text = re.sub(r"""((?:href|src)=|"search":)"/""", r'\1"', (html / LOST).read_text(encoding="utf-8"))
    text = text.replace("<head>", "<head>" + BEGIN.replace("FOLDERS", folders), 1)
    text = re.sub(r"\s*<h1>404 - Not found</h1>", LOST_WORDS, text)
    text = text.replace('new URL("/",location)', 'new URL(".",document.baseURI)')
    text = re.sub(r'<script src="assets', lambda found: BEGIN_OF_SEARCH + found[0], text, count=1)
    (html / LOST).write_text(text, encoding="utf-8")


def own_scripts(html: Path) -> list[str]:
    """Let the pages take their one foreign script from beside them; return those that still fetch from elsewhere."""
    asking = []
    for page in sorted(html.rglob("*.html")):
        here = "../" * (len(page.relative_to(html).parts) - 1) + "site/iframe-worker.js"
        text = page.read_text(encoding="utf-8").replace(SHIM, here)
        page.write_text(text, encoding="utf-8")
        if re.search(r"""(?:src=|<link [^>]*href=|url\()["']?(?:https?:)?//""", text):
            asking.append(page.name)
    return asking


def pages(folder: Path) -> Iterator[str]:
    """Yield the pages that a menu has to name; the decisions have a list of their own."""
    for page in sorted(folder.rglob("*.md")):
        if not page.name.startswith("00"):
            yield page.relative_to(folder).as_posix()


def named(entry: object) -> set[str]:
    """Return every page that a menu names, however deep."""
    if isinstance(entry, dict):
        return set().union(*map(named, entry.values()))
    if isinstance(entry, list):
        return set().union(*map(named, entry))
    return {entry} if isinstance(entry, str) and entry.endswith(".md") else set()


if __name__ == "__main__":
    sys.exit(main())
