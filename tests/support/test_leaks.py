import os
import subprocess
import sys

import pytest

from tests.support import ROOT

pytestmark = pytest.mark.slow

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


@pytest.fixture
def outcome(tmp_path):
    """Run a test file in a process of its own under the checks that every test here is under."""

    def run(text):
        lines = text.strip("\n").splitlines()
        margin = len(lines[0]) - len(lines[0].lstrip())
        (tmp_path / "test_it.py").write_text("\n".join(line[margin:] for line in lines) + "\n")
        options = ["-p", "tests.support.leaks", "-p", "no:randomly", "-p", "no:cacheprovider", "--rootdir", tmp_path]
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-c", os.devnull, *options, "test_it.py"],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )

    return run


@pytest.mark.parametrize("leak", LEAKS)
def test_a_leak_fails_its_test_and_is_named(outcome, leak):
    done = outcome(LEAKS[leak])
    assert done.returncode == 1, done.stdout
    assert f"the test left {leak}" in done.stdout
    assert "1 passed, 1 error" in done.stdout


def test_a_test_that_ends_what_it_began_passes(outcome):
    done = outcome(CLEAN)
    assert done.returncode == 0, done.stdout
