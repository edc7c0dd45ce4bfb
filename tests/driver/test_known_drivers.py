"""A robot finds its drivers by name and does not import them."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from lfield.driver.driver_index import (
    GROUP,
    DriverIndex,
    DriverInfo,
    ManifestFile,
    installed_drivers,
)
from lfield.driver.plugin import check_same
from lfield.driver.plugins import discover
from lfield.errors import PluginError

SERVO = DriverInfo("servo", "lfield_servo:PLUGIN", {}, {}, "lfield-servo 1.2")
KNOWN = DriverIndex({"servo": SERVO})


def entry(name: str, reference: str) -> EntryPoint:
    return EntryPoint(name, reference, GROUP)


def servo_reference(*entries: EntryPoint) -> str:
    return installed_drivers(KNOWN, ["servo"], entries).by_driver["servo"].reference


def test_driver_is_found_by_name_else_by_reference() -> None:
    assert servo_reference(entry("servo", "other_package:SERVO")) == "other_package:SERVO"
    assert servo_reference(entry("x", "lfield_servo:PLUGIN")) == "lfield_servo:PLUGIN"
    assert "other_package" not in sys.modules


def test_missing_driver_names_the_package_to_install() -> None:
    with pytest.raises(PluginError, match=r"driver 'servo' is not installed: install lfield-servo 1\.2"):
        servo_reference(entry("winch", "lfield_winch:PLUGIN"))


def test_unneeded_drivers_are_not_searched() -> None:
    assert installed_drivers(KNOWN, [], [entry("servo", "x:Y")]).by_driver == {}


def test_installed_driver_has_manifests_files_and_distribution() -> None:
    can = discover().by_driver["can"]
    assert can.distribution.startswith("lfield ")
    assert (
        can.for_types({"CanAxis"}).manifests.keys() == can.for_types({"CanAxis"}).files.keys() == {"CanAxis"}
    )
    assert can.files["CanAxis"].name == "axis.yaml"
    check_same(can, can.plugin)


def test_driver_with_a_different_manifest_is_refused() -> None:
    known = DriverInfo("servo", "x:Y", {}, {"Servo": ManifestFile("servo.yaml", bytes(32))}, "")
    check_same(known, SimpleNamespace(has_manifest=lambda file: True))
    with pytest.raises(PluginError, match=r"\(servo.yaml differs\): install the package of x:Y, or build"):
        check_same(known, SimpleNamespace(has_manifest=lambda file: False))
