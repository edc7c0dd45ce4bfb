"""Missing requirements of the emulated radio are reported by name: root, the TUN device, tools."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from emulator import tun


@pytest.fixture(autouse=True)
def as_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)


def test_user_without_root_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "root" in tun.missing()


def test_missing_tun_device_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tun, "CLONE", tmp_path / "tun")
    assert str(tmp_path / "tun") in tun.missing()


def test_missing_tools_are_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tun, "CLONE", tmp_path)
    monkeypatch.setattr(shutil, "which", lambda tool: None if tool == "nsenter" else f"/usr/bin/{tool}")
    assert "nsenter" in tun.missing()
    assert "unshare" not in tun.missing()
