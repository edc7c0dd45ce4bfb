"""Manifest files of drivers: their values and their errors."""

from __future__ import annotations

import pytest

from lfield.driver.manifest_file import load_manifest
from lfield.errors import PluginError
from lfield_mavlink import PLUGIN

SERVO = b"""\
driver: servo
type: Servo
meaning: one servo
safe_states: [hold, off]
options:
  id: {type: int, default: 1, minimum: 1, maximum: 252, meaning: its number}
limits:
  speed: {unit: rad/s}
instructions:
  turn: {parameters: {angle: {type: real, unit: rad}}, blocking: true, meaning: turns, cancel: stop}
  stop: {blocking: true, effect: idempotent, cancel: never}
  look: {effect: query, blocking: true}
  dim: {blocking: true, channel: light, cancel: leave}
  push: {parameters: {torque: {type: real, unit: N m}}}
  ask: {parameters: {address: {type: int}}, result: int, effect: query, blocking: true}
telemetry:
  angle: {type: real, unit: rad, max_age: 0.5, meaning: where it is}
"""


def test_manifest_has_the_values_of_its_file():
    manifest = load_manifest("m.yaml", SERVO)
    device = manifest.device
    assert (device.type, device.driver, device.safe_states) == ("Servo", "servo", ("hold", "off"))
    assert manifest.default_safe_state == "hold"
    assert [i.name for i in device.instructions] == [
        "turn",
        "stop",
        "look",
        "dim",
        "push",
        "ask",
        "angle",
        "release",
        "age",
    ]
    turn, angle = device.instruction("turn"), device.instruction("angle")
    assert turn is not None
    assert [(p.name, p.type, p.unit) for p in turn.parameters] == [("angle", "real", "rad")]
    assert (turn.blocking, turn.effect, turn.result) == (True, "actuate", "void")
    assert (turn.cancel, turn.may_be_cancelled) == ("stop", True)
    cancelled = {i.name for i in device.instructions if i.may_be_cancelled}
    assert cancelled == {"turn", "look", "dim", "ask"}, (
        "`stop`, setpoints, `release` and quantities cannot be cancelled"
    )
    assert angle is not None
    assert (angle.effect, angle.result, angle.unit, angle.blocking) == ("query", "real", "rad", False)
    assert device.telemetry[0].max_age == 0.5
    assert (manifest.options[0].name, manifest.options[0].default) == ("id", 1)
    assert manifest.limits[0].unit == "rad/s"
    assert manifest.options[0].meaning == "its number"


WINCH = b"""\
driver: winch
type: Winch
safe_states: [brake]
options:
  ids: {type: "int[]", default: []}
  key_file: {type: path, default: ""}
reasoned: [no_homing]
waivers:
  no_homing: it moves before it has been homed
instructions:
  light: {parameters: {on: {type: boolean}}, blocking: true, channel: light, cancel: leave}
telemetry:
  length: {type: real, unit: m, rate: 20.0}
"""


def test_manifest_with_list_options_waivers_channels_and_rates():
    manifest = load_manifest("m.yaml", WINCH)
    device = manifest.device
    assert [(o.name, o.type, o.default) for o in manifest.options] == [
        ("ids", "int[]", []),
        ("key_file", "path", ""),
    ]
    assert [name for name, _ in manifest.waivers] == ["device_watchdog", "no_homing"]
    assert manifest.reasoned == ("no_homing",)
    light = device.instruction("light")
    assert light is not None
    assert light.channel == "light"
    assert device.telemetry[0].rate == 20.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"driver: servo\n", b"", "error[Y110]: a manifest needs 'driver'"),
        (b"type: Servo", b"type: servo", "m.yaml:2:7: error[Y113]: 'servo' cannot be a name in L here"),
        (b"[hold, off]", b"[]", "error[Y110]: a manifest needs at least one safe state"),
        (b"  turn:", b"  Turn:", "m.yaml:10:3: error[Y113]: 'Turn' cannot be a name in L here"),
        (
            b"type: real, unit: rad}}",
            b"type: float}}",
            "error[Y113]: 'type' must be one of boolean, int, real",
        ),
        (b"type: real, unit: rad}}", b"type: real, unit: banana}}", "Y113]: 'banana' is not a unit"),
        (
            b"blocking: true, meaning: turns",
            b"blockin: true",
            "m.yaml:10:56: error[Y111]: 'turn' has no key 'blockin'",
        ),
        (
            b"  angle: {type: real, unit: rad, max",
            b"  turn: {type: real, max",
            "'turn' is already an instruction",
        ),
        (b"  push:", b"  release:", "'release' is already an instruction of this device type"),
        (b"effect: query, blocking: true", b"effect: query", "'ask' is a query that does not ask the device"),
        (b", cancel: stop", b"", "m.yaml:10:3: error[Y110]: 'turn' does not declare what a cancel does"),
        (b"cancel: stop", b"cancel: halt", "m.yaml:10:96: error[Y113]: there is no other instruction 'halt'"),
        (b"cancel: stop", b"cancel: turn", "there is no other instruction 'turn'"),
        (b"cancel: stop", b"cancel: push", "'push' has parameters"),
        (b"cancel: stop", b"cancel: angle", "there is no other instruction 'angle'"),
        (b"cancel: stop", b"cancel: look", "'look' is not a blocking instruction that acts"),
        (b"cancel: stop", b"cancel: dim", "'dim' is on channel light, but 'turn' is on motion"),
        (b"result: int,", b"result: int, cancel: never,", "'ask' cannot be cancelled: only a blocking"),
        (b"{torque: {type: real, unit: N m}}", b"{}, cancel: leave", "'push' cannot be cancelled"),
        (b"max_age: 0.5", b"max_age: 0", "'max_age' must be at least 0.001, not 0"),
        (b"unit: rad/s}", b"unit: rad/s, min: 1}", "'speed' has no key 'min'"),
        (b"limits:\n", b"fakes: {any: {id: 3, wings: 2}}\nlimits:\n", "'any' has no key 'wings'"),
    ],
)
def test_manifest_error_is_reported_at_its_position(old, new, expected):
    assert old in SERVO
    with pytest.raises(PluginError) as error:
        load_manifest("m.yaml", SERVO.replace(old, new))
    assert expected in str(error.value)


def test_fake_options_depend_on_the_resource():
    fakes = b"fakes: {Gripper: {id: 7, model: [1, 2]}, any: {id: 3}}\noptions:\n  model: {type: 'int[]'}\n"
    manifest = load_manifest("m.yaml", SERVO.replace(b"options:\n", fakes))
    assert manifest.fake_options("Gripper") == {"id": 7, "model": [1, 2]}
    assert manifest.fake_options("Servo") == {"id": 3}


def test_all_manifest_errors_are_reported_at_once():
    with pytest.raises(PluginError) as error:
        load_manifest("m.yaml", SERVO.replace(b"driver: servo\n", b"").replace(b"  turn:", b"  Turn:"))
    assert str(error.value).count("error[") == 2


def test_mavlink_manifest_has_its_instructions_and_quantities():
    device = PLUGIN.read_manifests()["Mavlink"].device
    assert device.type == "Mavlink"
    names = {i.name for i in device.instructions}
    actions = {"arm", "disarm", "takeoff", "goTo", "yaw", "setVelocity", "hold", "land", "release"}
    queries = {
        "position",
        "velocity",
        "attitude",
        "altitude",
        "battery",
        "batteryVoltage",
        "mode",
        "armed",
        "age",
    }
    assert actions | queries <= names
    assert all(i.meaning for i in device.instructions)


EYE = b"""\
driver: eye
type: Eye
instructions:
  ask: {result: int, effect: query, blocking: true}
telemetry:
  light: {type: real, rate: 20.0}
"""


@pytest.mark.parametrize("written", [b"", b"safe_states: []\n"])
def test_sensor_needs_no_safe_state(written):
    manifest = load_manifest("m.yaml", EYE + written)
    assert (manifest.device.safe_states, manifest.default_safe_state, manifest.waivers) == ((), "", ())


def test_device_that_acts_needs_a_safe_state():
    with pytest.raises(PluginError, match=r"at least one safe state because dim\(\) acts") as error:
        load_manifest(
            "m.yaml",
            EYE.replace(b"  ask:", b"  dim: {effect: idempotent, blocking: true, cancel: never}\n  ask:"),
        )
    assert "only if all instructions are queries" in str(error.value)
