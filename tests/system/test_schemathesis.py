"""A foreign program calls every route as the API description allows and as it forbids, and checks the answers by it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import PATIENCE_S
from tests.system.processes import Process, wait_until

TOKEN = "t" * 43
CONFIG = """
[api]
listen = "127.0.0.1:0"
token_file = "{folder}/api.token"
[bridge]
listen = "127.0.0.1:0"
send_to = []
[simulation]
speed = 5
"""


@pytest.fixture
def url(tmp_path):
    """A service on the simulated rig, five times as fast as real."""
    token = tmp_path / "api.token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    config = tmp_path / "heliocube.toml"
    config.write_text(CONFIG.format(folder=tmp_path))
    with (tmp_path / "out").open("wb") as out:
        service = Process(["run", "--config", config], tmp_path / "log", stdout=out)
    try:
        said = wait_until(lambda: re.search(r"http://\S+:\d+", (tmp_path / "out").read_text()), service.log)
        yield f"{said[0]}/api/openapi.json"
        assert service.exit_code is None
        assert "Traceback" not in service.log()
    finally:
        service.ask_to_stop()
        service.wait()


@pytest.mark.long
def test_every_route_of_the_api_answers_as_its_description_says(url, tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "schemathesis.cli"),
            *("--config-file", Path(__file__).with_name("schemathesis.toml"), "run", url),
            *("--header", f"Authorization: Bearer {TOKEN}", "--exclude-path", "/api/events"),
            *("--phases", "coverage,fuzzing", "--max-examples", "3", "--seed", "1", "--generation-database", "none"),
        ],
        cwd=tmp_path,
        env=os.environ | {"CONFIGURATION": str(tmp_path / "heliocube.toml"), "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]
    assert int(re.search(r"(\d+) generated", done.stdout)[1]) > 300, done.stdout[-4000:]
