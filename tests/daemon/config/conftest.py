"""Settings from the text of a file."""

import textwrap

import pytest

from daemon.config.file import ConfigError, load_settings


@pytest.fixture
def read(tmp_path):
    """Read settings from the text of a file."""

    def read_text(text):
        file = tmp_path / "heliocube.toml"
        file.write_text(textwrap.dedent(text))
        return load_settings(file)

    return read_text


@pytest.fixture
def problem(read):
    """Return the one sentence with which the text of a file is refused."""

    def only_problem(text):
        with pytest.raises(ConfigError) as caught:
            read(text)
        (line,) = caught.value.problems
        return line

    return only_problem
