"""The service and a rotator behind rotctld: the simulated one of the bench, and Hamlib's own."""

import pytest

from daemon.commands.file_check import check_file
from drivers.positioners.rotctld.mount import angles
from tests.support import forks
from tests.system.processes import wait_until
from tests.system.rig import WITHIN_DEG, Rig, brisk, law_says

pytestmark = pytest.mark.system
# Not near the zenith, where an azimuth turns far for a small change of the sky.
LOWER_SUN = ("--weather", "clear", "--site", "30,0", "--start", "2022-09-21T11:50Z")


def test_the_service_drives_the_rotator_of_a_bench_and_uses_it_again_after_a_pulled_plug(
    tmp_path, start_bench, start_service
):
    bench = start_bench("--config", brisk(tmp_path), *LOWER_SUN, "--positioner", "rotctld")
    settings = check_file(bench.config).instruments.positioner
    assert settings.server == f"127.0.0.1:{bench.state()['positioner']['tcp_port']}"
    rig = Rig(bench, start_service(bench.config))
    rig.settle()
    bench.ask("unplug", "positioner")
    wait_until(lambda: rig.lines("the positioner is down") == 1, rig.service.log)
    bench.ask("replug", "positioner")
    wait_until(lambda: rig.lines("the positioner is back") == 1, rig.service.log)
    rig.new_sky()
    rig.settle()
    # Wait until its last move is over for the service too.
    stays = rig.lines("staying")
    wait_until(lambda: rig.lines("staying") > stays, rig.service.log)
    stops = bench.state()["positioner"]["received"]["stop"]
    bench.ask("turn", "100", "30")
    wait_until(lambda: rig.lines("azimuth moved from") > 0, rig.service.log)
    assert bench.state()["positioner"]["received"]["stop"] > stops


def test_a_real_rotctld_follows_the_simulated_sky_and_is_used_again_after_it_was_killed(
    tmp_path, start_bench, start_service, start_rotctld
):
    # Offsets set where the dummy begins. They make the limits that it reports wrong, so the file gives the limits.
    server = start_rotctld("-o", "-180", "-O", "-40")
    config = brisk(
        tmp_path,
        positioner="azimuth_min_deg = 0.0\nazimuth_max_deg = 360.0\n"
        "elevation_min_deg = 40.0\nelevation_max_deg = 90.0\n[limits]\nb_min_deg = 40.0\n",
    )
    config.write_text(config.read_text().replace("[safety]", "[safety]\nsnow_b_deg = 40.0"))
    bench = start_bench("--config", config, *LOWER_SUN, "--rotctld", server.place)
    assert "pose" not in bench.state()
    service = start_service(bench.config)

    def follows():
        azimuth_deg, elevation_deg = map(float, server.ask("p\n", b"\n").split()[:2])
        stands = angles(azimuth_deg, elevation_deg, 180.0)
        return all(abs(here - there) <= WITHIN_DEG for here, there in zip(stands, law_says(bench), strict=True))

    wait_until(follows, service.log)
    bench.ask("shade", "zenith", 0.5)
    wait_until(lambda: not follows(), service.log)
    wait_until(follows, service.log)
    server.kill()
    wait_until(lambda: "nothing listens at" in service.log(), service.log)
    server.start()
    wait_until(lambda: "the positioner is back" in service.log(), service.log)
    assert "move failed" not in service.log()


def heliocube(*arguments):
    return forks.run(*arguments)


def test_config_init_writes_a_file_for_the_named_instruments_and_refuses_an_unknown_one(tmp_path):
    written = heliocube("config", "init", tmp_path / "lab", "--positioner", "rotctld", "--cube", "scanning-meter")
    assert written.returncode == 0, written.stderr
    file = tmp_path / "lab" / "heliocube.toml"
    instruments = check_file(file).instruments
    assert (instruments.positioner.driver, instruments.cube.driver) == ("rotctld", "scanning-meter")
    text = file.read_text()
    assert "azimuth_min_deg" in text
    assert "meter_range_v" in text
    assert "a_axis" not in text
    wrong = heliocube("config", "init", tmp_path / "other", "--positioner", "rotor")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "rotctld" in wrong.stderr
    assert not (tmp_path / "other").exists()


def test_the_simulated_rig_runs_with_a_rotator_by_one_option_and_an_unknown_positioner_is_refused():
    run = heliocube("run", "--positioner", "rotctld", "--for", "3")
    assert run.returncode == 0, run.stderr
    assert "motion is stopped" in run.stdout
    mistaken = heliocube("run", "--positioner", "lathe", "--for", "1")
    assert (mistaken.returncode, '"pozsol"' in mistaken.stderr, "Traceback" in mistaken.stderr) == (2, True, False)
