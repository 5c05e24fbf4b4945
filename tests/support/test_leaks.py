import os
import re
import subprocess
import sys
import textwrap
from collections import defaultdict

import pytest

from tests.support import PATIENCE_S, ROOT

pytestmark = [pytest.mark.slow, pytest.mark.live]

LEAKS = {
    "tasks pending": """
        import asyncio

        kept = []

        def test_it():
            async def scene():
                kept.append(asyncio.create_task(asyncio.sleep(3600), name="forgotten"))
                await asyncio.sleep(0)

            with asyncio.Runner() as runner:
                runner.run(scene())
        """,
    "threads running": """
        import threading

        def test_it():
            threading.Thread(target=threading.Event().wait, name="forgotten", daemon=True).start()
        """,
    "file descriptors open": """
        import socket

        kept = []

        def test_it():
            kept.append(socket.socket())
        """,
    "processes running": """
        import subprocess
        import sys

        kept = []

        def test_it():
            kept.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)  # forgotten"]))
        """,
}
CLEAN = """
    import asyncio
    import subprocess
    import sys
    import threading

    def test_it():
        async def scene():
            task = asyncio.create_task(asyncio.sleep(3600))
            await asyncio.sleep(0)
            task.cancel()

        asyncio.run(scene())
        thread = threading.Thread(target=lambda: None)
        thread.start()
        thread.join()
        subprocess.run([sys.executable, "-c", ""], check=True)
    """


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Run all these test files in one process, under the checks that every test here is under.

    Returns the final report of each file, by its name. With a process each, four fifths of the time would be startup.
    """
    folder = tmp_path_factory.mktemp("leaks")
    for name, text in {**LEAKS, "nothing": CLEAN}.items():
        (folder / f"test_{name.replace(' ', '_')}.py").write_text(textwrap.dedent(text))
    options = ["-p", "tests.support.leaks", "-p", "no:randomly", "-p", "no:cacheprovider", "--rootdir", folder, "-rA"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-c", os.devnull, *options, folder],
        cwd=folder,
        # The lines of the summary are cut to the width of a terminal.
        env=os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "1000"},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 1, done.stdout
    _, _, summary = done.stdout.partition("short test summary info")
    said = defaultdict(list)
    for word, name, rest in re.findall(r"^([A-Z]+) test_(\w+)\.py::test_it(.*)$", summary, re.MULTILINE):
        said[name.replace("_", " ")].append(f"{word}{rest}")
    return said


@pytest.mark.parametrize("leak", LEAKS)
def test_a_leak_fails_its_test_and_is_named(outcomes, leak):
    passed, error = outcomes[leak]
    assert passed == "PASSED"
    assert error.startswith(f"ERROR - AssertionError: the test left {leak}")


def test_a_test_without_leaks_passes(outcomes):
    assert outcomes["nothing"] == ["PASSED"]
