"""What a computer lacks for the emulated radio: one sentence that tests and the bench print."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from emulator import tun


@pytest.fixture(autouse=True)
def as_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)


def test_the_user_is_not_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "root" in tun.missing()


def test_there_is_no_tun_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tun, "CLONE", tmp_path / "tun")
    assert str(tmp_path / "tun") in tun.missing()


def test_there_are_no_tools(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tun, "CLONE", tmp_path)
    monkeypatch.setattr(shutil, "which", lambda tool: None if tool == "nsenter" else f"/usr/bin/{tool}")
    assert "nsenter" in tun.missing()
    assert "unshare" not in tun.missing()
