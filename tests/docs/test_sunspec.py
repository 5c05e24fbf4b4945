"""The example of docs/sunspec.md is the default but for being on."""

import re

from daemon.config.file import load_settings
from daemon.config.links import SunspecSettings
from tests.support import DOCS


def test_the_sunspec_page_example_equals_the_defaults_except_for_being_enabled(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", (DOCS / "sunspec.md").read_text(encoding="utf-8"), re.DOTALL)
    path = tmp_path / "heliocube.toml"
    path.write_text(example, encoding="utf-8")
    assert load_settings(path).sunspec == SunspecSettings(enabled=True)
