"""The GPS driver: its parser, the driver with the simulated receiver, and its conformance kit."""

from __future__ import annotations

import asyncio
import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lfield_gps import PLUGIN
from lfield_gps.fake import FAULTS, LATITUDE, LONGITUDE, SIM, Receiver, sentences
from lfield_gps.nmea import InvalidSentence, parse, sentence

from lfield.clock import SystemClock
from lfield.devices.conformance_run import conformance_checks, run_conformance
from lfield.driver import DeviceError
from lfield.driver.plugins import Plugins
from lfield.lang.frontend import check_text
from lfield.testing.desk import Desk
from lfield.testing.driver_bench import DriverBench, bind
from lfield_sim.faults import Faults

HOME = Path(__file__).parents[1]


def test_reference_sentences_are_parsed():
    gga = parse(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r")
    assert gga["position"] == pytest.approx([48.1173, 11.516667, 545.4], abs=1e-6)
    assert (gga["fix"], gga["satellites"]) == ("gps", 8)
    rmc = parse(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A")
    assert rmc["utc"] == "1994-03-23T12:35:19Z"
    assert rmc["speed"] == pytest.approx(11.5236, abs=1e-4)
    assert rmc["course"] == pytest.approx(math.radians(84.4))
    assert parse(b"$GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1*39") == {"dilution": 2.5}
    assert parse(sentence("GPGSV,3,1,11")) == {}


def test_south_and_west_are_negative_and_unknown_values_are_omitted():
    values = parse(sentence("GPGGA,120000,3352.0,S,07040.0,W,4,12,0.9,520.0,M,,M,,"))
    assert values["position"] == pytest.approx([-33.866667, -70.666667, 520.0], abs=1e-6)
    assert values["fix"] == "rtk"
    assert parse(sentence("GPGGA,,,,,,0,00,,,M,,M,,")) == {"fix": "none", "satellites": 0}
    assert parse(sentence("GPRMC,,V,,,,,,,,,,N")) == {}


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"$",
        b"$GPGGA*",
        b"$GPGSA,A,3*00",
        b"\xff\xfe",
        sentence("GPGGA,1,9107.0,N,01131.0,E,1,8,1,5,M,,,"),
        sentence("GPGGA,1,4807.0,N,01161.0,E,1,8,1,5,M,,,"),
        sentence("GPGGA,1,4807.0,N"),
        sentence("GPGGA,1,4807.0,N,01131.0,E,1,8,1,nan,M,,,"),
        sentence("GPRMC,996161,A,,,,,1,1,990099,,"),
    ],
)
def test_invalid_sentence_is_refused(line):
    with pytest.raises(InvalidSentence):
        parse(line)


@given(st.binary(max_size=90) | st.text(max_size=60).map(lambda text: b"$GPGGA," + text.encode() + b"*00"))
def test_any_line_is_parsed_or_refused(line):
    with suppress(InvalidSentence):
        assert isinstance(parse(line), dict)


@given(st.floats(0.0, 1e6))
def test_simulated_receiver_sends_valid_sentences(seconds):
    values = {}
    for line in sentences(seconds).splitlines():
        assert len(line) <= 82
        values |= parse(line)
    assert set(values) == {"position", "fix", "satellites", "dilution", "speed", "course", "utc"}
    assert math.dist(values["position"][:2], (LATITUDE, LONGITUDE)) < 0.001


class Setup:
    """A driver bench with a simulated receiver on a pseudo-terminal, in real time, at 10 Hz."""

    def __init__(self, folder: Path, connect: float = 60.0) -> None:
        self.faults, self._path = Faults(FAULTS, ["1"]), folder / "gps"
        binding = bind(PLUGIN, endpoint=f"serial:{folder / 'gps'}:9600", options={"connect": connect})
        self.bench = DriverBench(PLUGIN, binding, fakes=[self.run_receiver])

    async def run_receiver(self) -> None:
        receiver = Receiver(self._path, self.faults, 10.0)
        try:
            await receiver.run()
        finally:
            receiver.set_plugged(False)


@pytest.fixture
def setup(tmp_path):
    return Setup(tmp_path)


def test_receiver_reports_its_position(setup):
    async def scenario(gps):
        assert await gps.execute("waitFix", [5.0]) is True
        await setup.bench.until(lambda: "course" in setup.bench.values)
        assert setup.bench.values["position"][:2] == pytest.approx([LATITUDE, LONGITUDE], abs=0.001)
        assert setup.bench.values["speed"] == pytest.approx(2.0, abs=0.01)
        assert gps.moving() == ""

    setup.bench.run_real(scenario)


def test_damaged_sentences_are_counted_and_dropped(setup):
    setup.faults.apply(["noise=0.01", "half=0.2"])

    async def scenario(gps):
        await setup.bench.until(lambda: setup.bench.values.get("malformed", 0) > 5)
        assert setup.bench.values["position"][:2] == pytest.approx([LATITUDE, LONGITUDE], abs=0.001)

    setup.bench.run_real(scenario)


def test_receiver_without_satellites_reports_no_position(setup):
    setup.faults.apply(["no_fix=true"])

    async def scenario(gps):
        await setup.bench.until(lambda: setup.bench.values.get("fix") == "none")
        assert await gps.execute("waitFix", [0.2]) is False
        assert "position" not in setup.bench.values

    setup.bench.run_real(scenario)


def test_driver_reconnects_after_the_adapter_was_unplugged(setup):
    async def scenario(gps):
        setup.faults.apply(["unplug=true"])
        await setup.bench.until(lambda: any("is gone" in note for note in setup.bench.notes))
        setup.faults.apply(["unplug=false"])
        await setup.bench.until(lambda: any("link opened" in note for note in setup.bench.notes))
        before = setup.bench.values["position"]
        await setup.bench.until(lambda: setup.bench.values["position"] != before)

    setup.bench.run_real(scenario)


def test_open_fails_if_the_port_is_silent(tmp_path):
    setup = Setup(tmp_path, connect=1.0)
    setup.faults.apply(["silent=true"])

    async def scenario(gps):
        with pytest.raises(
            DeviceError, match="received nothing within 1 s; check the wires and the baud rate"
        ):
            await gps.open()

    setup.bench.run_real(scenario, opened=False)


@pytest.mark.process
def test_simulated_receiver_process_passes_conformance_checks(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HOME), os.environ.get("PYTHONPATH", "")]))
    plugins = Plugins()
    plugins.add("lfield_gps:PLUGIN")
    command = [sys.executable, "-m", "lfield.driver.sims", "lfield_gps.fake:SIM", "--until-stdin-closes"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as fake:
        ready, endpoint = fake.stdout.readline().split()
        assert ready == "ready"
        checks, clock = conformance_checks(plugins.by_driver["gps"])[:3], SystemClock()
        gps = bind(PLUGIN, endpoint=endpoint)
        results = asyncio.run(
            run_conformance(plugins, [gps], checks, False, print, clock=clock, silence=10.0)
        )
        fake.stdin.close()
    assert [f.check for f in results if f.outcome == "passed"] == ["endpoint", "identity", "telemetry"]


def test_gps_passes_the_kit_without_motion():
    plugins = Plugins()
    plugins.add("lfield_gps:PLUGIN")
    desk = Desk(plugins=plugins)
    fake = desk.fake(SIM)
    results = desk.try_kit(bind(PLUGIN, endpoint=fake.endpoint), may_move=False)
    assert [f"{f.check}: {f.seen}" for f in results if f.outcome == "failed"] == []
    assert {f.check for f in results if f.outcome == "not run"} == {
        "the safe state is latched until release", "it comes to rest in its safe state",
    }  # fmt: skip
    assert len(results) == 13


def test_gps_stock_resource_compiles():
    plugins = Plugins()
    plugins.add("lfield_gps:PLUGIN")
    body = 'GpsPosition p = findGpsPosition("p"); p.waitFix(1.0); print(p.latitude());'
    text = f"coordinator C {{ init(string[] arg) {{ {body} }} }}"
    checked = check_text(
        f"include <gps/position.L>;\n{text}", devices=plugins.device_types, find_include=plugins.find_source
    )
    assert [d.render() for d in checked.diagnostics] == []
