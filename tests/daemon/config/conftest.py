"""Settings from the text of a file."""

import textwrap

import pytest

from daemon.config.file import load_settings


@pytest.fixture
def read(tmp_path):
    """Read settings from the text of a file."""

    def read_text(text):
        file = tmp_path / "heliocube.toml"
        file.write_text(textwrap.dedent(text))
        return load_settings(file)

    return read_text
