"""Fixtures of the system tier: a bench, and a service that drives it."""

import pytest
from processes import BenchProcess, Process
from rig import HIGH_SUN, Rig, brisk


@pytest.fixture
def start_bench(tmp_path):
    """Start a bench with the options of the command line; it ends with the test, in order."""
    started = []

    def start(*options, directory=None):
        started.append(BenchProcess(directory or tmp_path / "bench", *options))
        return started[-1]

    yield start
    for bench in started:
        assert bench.stop() == 0, bench.log()


@pytest.fixture
def start_service(tmp_path):
    """Start `heliocube run` on a configuration file; it ends with the test, in order and without a traceback."""
    started = []

    def start(config, *options):
        output = tmp_path / f"service{len(started)}.log"
        with output.open("ab") as stream:
            started.append(Process(["run", "--config", config, *options], output, stdout=stream))
        return started[-1]

    yield start
    for service in started:
        assert service.stop() == 0, service.log()
        assert "Traceback" not in service.log()


@pytest.fixture
def start_rig(tmp_path, start_bench, start_service):
    def start():
        bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
        return Rig(bench, start_service(bench.config))

    return start
