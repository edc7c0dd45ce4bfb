"""The systemd unit of deploy has a journal folder, and a stop timeout that lets devices come to rest."""

from __future__ import annotations

from configparser import RawConfigParser

from document_blocks import ROOT

from lfield.driver.binding import longest_rest
from lfield.mission.loader import load_mission


def unit() -> RawConfigParser:
    # The unit writes a list as several lines with the same key.
    read = RawConfigParser(strict=False)
    read.optionxform = str  # type: ignore[assignment, method-assign]
    read.read(ROOT / "deploy/lfield.service")
    return read


def test_unit_has_a_journal_folder_and_a_stop_timeout_over_the_longest_rest():
    service = unit()["Service"]
    assert service["StateDirectory"] == "lfield"
    mission = load_mission(
        ROOT / "deploy/two-copters/mission.dL", program=ROOT / "examples/01-first-flight/mission.L"
    )
    assert float(service["TimeoutStopSec"]) > longest_rest(mission.bindings.all)
