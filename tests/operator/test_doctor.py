"""The findings of `lfield doctor` on a computer made of files."""

from __future__ import annotations

import asyncio
import dataclasses
import os
import sys

import pytest

from lfield.clock import SystemClock
from lfield.driver.plugins import Plugins
from lfield.operator.diagnostics import DIAGNOSES, DiagnosticFinding, drivers, endpoints, system
from lfield.testing.driver_bench import bind
from switching_engine import NEEDED


@pytest.fixture
def findings(tmp_path):
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")

    def look():
        found = list(system(plugins, tmp_path))
        assert {finding.code for finding in found} <= DIAGNOSES.keys()
        return {finding.what: finding for finding in found}

    return look


def put(path, text=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def one(findings, words):
    (found,) = [finding for what, finding in findings.items() if words in what]
    return found


def test_doctor_reports_a_computer_without_ports(findings):
    assert one(findings(), "no serial ports").state == "ok"


@pytest.mark.parametrize(
    ("group", "state", "words"),
    [(7, "ok", "members of the group lfield"), (None, "note", "only this user and root")],
)
def test_doctor_reports_the_users_who_may_stop_a_run(findings, monkeypatch, group, state, words):
    monkeypatch.setattr("lfield.operator.diagnostics.shared_group_id", lambda: group)
    found = one(findings(), words)
    assert (found.state, "sudo groupadd --force lfield" in found.cure) == (state, group is None)


@pytest.mark.parametrize(
    ("installed", "state", "words"), [(True, "ok", "wasmtime "), (False, "note", "the reference engine runs")]
)
def test_doctor_reports_the_engine_of_programs(findings, monkeypatch, installed, state, words):
    monkeypatch.setattr("lfield.operator.diagnostics.has_wasm", lambda: installed)
    if installed:
        pytest.importorskip("wasmtime", reason=NEEDED)
    assert one(findings(), words).state == state


def test_doctor_reports_a_wasmtime_of_another_processor(findings, monkeypatch):
    monkeypatch.setattr("lfield.operator.diagnostics.has_wasm", lambda: True)
    monkeypatch.setitem(sys.modules, "lfield.vm.wasm.wasm_engine", None)
    monkeypatch.setattr("importlib.metadata.version", lambda name: "50.0.1")
    assert one(findings(), "wasmtime cannot be used").state == "warning"


def test_doctor_reports_a_wasmtime_that_cannot_compile_programs(findings, monkeypatch):
    """A wasmtime of another version creates the arena and the runtime, and rejects the code of `up`."""
    wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)

    def refuse(*_):
        raise wasmtime.WasmtimeError("WebAssembly translation error")

    monkeypatch.setattr("lfield.vm.wasm.wasm_engine.code_of", refuse)
    what = "the reference engine runs programs: wasmtime cannot be used: WebAssembly translation error"
    assert one(findings(), what).state == "warning"


def test_doctor_reports_a_slow_latency_timer_with_its_cure(findings, tmp_path):
    timer = put(tmp_path / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n")
    found = one(findings(), "ttyUSB0: holds bytes back for up to 16 ms")
    assert found.state == "warning"
    assert f"echo 1 | sudo tee {timer}" in found.cure
    timer.write_text("1\n")
    assert one(findings(), "ttyUSB0: holds bytes back for 1 ms").state == "ok"


def test_doctor_reports_a_port_without_permission(findings, tmp_path, monkeypatch):
    port = put(tmp_path / "dev/ttyACM0")
    assert one(findings(), f"{port}: may be used").state == "ok"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    found = one(findings(), f"{port}: ")
    assert found.state == "problem"
    assert "sudo usermod -aG" in found.cure


def test_doctor_reports_a_can_interface_that_is_down(findings, tmp_path):
    state = put(tmp_path / "sys/class/net/can0/operstate", "down\n")
    found = one(findings(), "can0: down")
    assert (found.state, "ip link set can0 up" in found.cure) == ("problem", True)
    state.write_text("up\n")
    assert one(findings(), "can0: up").state == "ok"


@pytest.fixture
def bare(monkeypatch):
    """The MAVLink driver as it is installed without its extra."""
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    found = plugins.by_driver["mavlink"]
    bare = dataclasses.replace(found.plugin, requires=("no_such_library",))
    monkeypatch.setattr("lfield_mavlink.PLUGIN", bare)
    plugins.by_driver["mavlink"] = dataclasses.replace(found, plugin=bare)
    return plugins


@pytest.mark.parametrize(("used", "state"), [((), "note"), (("can",), "note"), (("mavlink",), "problem")])
def test_a_missing_library_is_a_problem_of_missions_that_use_its_driver(bare, used, state):
    (found,) = drivers(bare, used)
    assert found.what == "driver mavlink: not installed: no_such_library"
    assert (found.state, found.cure) == (state, "pip install 'lfield[mavlink]'")


def test_a_device_of_a_driver_without_its_library_is_not_tried(bare):
    told: list[DiagnosticFinding] = []
    asyncio.run(
        endpoints(bare, [bind(bare.by_driver["mavlink"].plugin, "Mavlink")], SystemClock(), told.append)
    )
    assert [(f.state, f.what, f.cure) for f in told] == [
        ("problem", "bench.device: not tried without its driver", "pip install 'lfield[mavlink]'")
    ]


def test_doctor_reports_a_plugin_that_cannot_be_used(tmp_path):
    plugins = Plugins()
    plugins.add("no_such_package:PLUGIN")
    assert one({f.what: f for f in system(plugins, tmp_path)}, "no_such_package").state == "problem"
