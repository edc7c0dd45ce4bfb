"""The endpoints of a driver are checked before a device is opened."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import run_kit
from lfield.driver.plugin import Plugin, load_plugin
from lfield.driver.standard_checks import endpoint_check
from lfield.errors import DeviceError, PluginError

ENDPOINTS = {
    "mavlink": (
        ["udp:127.0.0.1:14550", "udpin:0.0.0.0:1", "tcp:h:65535", "serial:/dev/x:57600", "tcp:h:1, udp:h:2"],
        [
            "",
            "foo:bar",
            "udp:h:0",
            "udp:h:99999",
            "serial:/dev/x:fast",
            "serial:/dev/x:0",
            "tcp:h:1,",
            "can:can0",
        ],
    ),
    "dynamixel": (
        ["serial:/dev/ttyUSB0:1000000"],
        ["", "serial:/dev/x", "udp:h:1", "serial:/dev/x:13000000"],
    ),
    "can": (
        ["socketcan:can0", "virtual:a", "slcan:/dev/ttyACM0@115200?bitrate=500000", "socketcand:h:1/can0"],
        ["", "can0", "socketcan:", "slcan:ttyACM0", "socketcand:h:0/can0", "socketcand:h:1/can0?a=b"],
    ),
}


@pytest.mark.parametrize("driver", ENDPOINTS)
def test_endpoints_of_the_drivers_are_accepted_or_refused(driver):
    plugin = load_plugin(f"lfield_{driver}:PLUGIN")
    good, bad = ENDPOINTS[driver]
    assert [text for text in good if plugin.why_no_endpoint(text)] == []
    assert [text for text in bad if not plugin.why_no_endpoint(text)] == []


def test_endpoint_check_imports_no_vendor_library():
    calls = "".join(
        f"load_plugin('lfield_{driver}:PLUGIN').why_no_endpoint({good[0]!r})\n"
        for driver, (good, _) in ENDPOINTS.items()
    )
    vendors = "{'can', 'canopen', 'cantools', 'serial', 'pymavlink', 'dynamixel_sdk'}"
    text = "import sys\nfrom lfield.driver.plugin import load_plugin\n"
    text += f"{calls}print({vendors} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "set()"


def parse(text: str) -> None:
    """Parse an endpoint of the driver `thing`."""
    if text == "broken":
        raise RuntimeError("a bug")
    if not text.startswith("thing:"):
        raise DeviceError("endpoint", "write thing:NUMBER")


def anything(text: str) -> None:
    """Accept any endpoint."""


def plugin(function: str, requires: tuple[str, ...] = ()) -> Plugin:
    path = f"{__name__}:{function}" if function else ""
    return Plugin("thing", "thing", "thing:Thing", requires=requires, endpoint=path)


def test_plugin_with_and_without_an_endpoint_parser():
    assert plugin("parse").why_no_endpoint("thing:1") == ""
    assert plugin("parse").why_no_endpoint("") == "write thing:NUMBER"
    assert plugin("").why_no_endpoint("") == ""
    assert plugin("parse", ("vendor_that_is_not_here",)).why_no_endpoint("") == ""
    with pytest.raises(PluginError, match="driver 'thing' cannot parse the endpoint 'broken': a bug"):
        plugin("parse").why_no_endpoint("broken")
    with pytest.raises(PluginError, match="cannot be loaded from"):
        plugin("nowhere").why_no_endpoint("")


def only_first(bindings):
    """Refuse all bindings except the first."""
    if bindings[0].endpoint == "broken":
        raise RuntimeError("a bug")
    return ((binding, "one too many") for binding in bindings[1:])


def test_plugin_with_and_without_a_comparison_of_bindings():
    def compare(function, *endpoints, requires=()):
        plugin = Plugin(
            "thing", "t", "t:T", requires=requires, conflicts=function and f"{__name__}:{function}"
        )
        bindings = [
            DeviceBinding(agent=e, field="b", type="T", driver="thing", endpoint=e) for e in endpoints
        ]
        return [(binding.agent, reason) for binding, reason in plugin.conflicts_of(bindings)]

    assert compare("only_first", "1", "2") == [("2", "one too many")]
    assert compare("", "1", "2") == []
    assert compare("only_first", "1", "2", requires=("vendor_that_is_not_here",)) == []
    with pytest.raises(PluginError, match="driver 'thing' cannot compare its bindings: a bug"):
        compare("only_first", "broken")


class OpenBench:
    """A bench with a device whose endpoint is open."""

    confirmed = False

    def __init__(self, endpoint: str) -> None:
        self.binding = DeviceBinding(agent="a", field="b", type="T", driver="thing", endpoint=endpoint)


@pytest.mark.parametrize(
    ("function", "endpoint", "outcome", "seen"),
    [
        ("parse", "thing:1", "passed", "invalid endpoints are refused before anything is opened"),
        ("parse", "other:1", "failed", "it is open, but its endpoint is refused: write thing:NUMBER"),
        ("anything", "thing:1", "failed", "it accepts '' as an endpoint"),
    ],
)
async def test_kit_checks_the_endpoint_parser(function, endpoint, outcome, seen):
    kit = run_kit(OpenBench(endpoint), [endpoint_check(plugin(function))], may_move=False)
    (finding,) = [finding async for finding in kit]
    assert (finding.check, finding.outcome, finding.seen) == ("endpoint", outcome, seen)
