"""Cached bundles: reuse, rebuild, and untrusted bundles."""

from __future__ import annotations

import os
import stat
import subprocess
import time
from pathlib import Path

import builds_here
import pytest
from missions import CAPABILITIES, PLAIN, write_plain, write_rich

from lfield.errors import BundleError
from lfield.mission import build_cache, bundle
from lfield.mission.build_cache import BuildFailed, BuildRequest, cache_folder, cached_bundle
from lfield.text.secure_files import lock_private_folder


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A separate cache for the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = cache_folder()
    assert found is not None
    return found


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[BuildRequest]:
    """The requests that were built."""
    orders: list[BuildRequest] = []
    builds_here.use(monkeypatch)
    build = build_cache._build

    def counted(order: BuildRequest, workshop: Path) -> Path:
        orders.append(order)
        return build(order, workshop)

    monkeypatch.setattr(build_cache, "_build", counted)
    return orders


def bytes_of(order: BuildRequest) -> bytes:
    with cached_bundle(order) as path:
        return path.read_bytes()


def test_an_unchanged_mission_is_built_once(tmp_path: Path, built: list[BuildRequest]) -> None:
    order = BuildRequest(write_plain(tmp_path / "here"))
    assert bytes_of(order) == bytes_of(order)
    assert len(built) == 1
    with cached_bundle(order) as path:
        assert list(bundle.read(path).team.hosts) == ["alpha", "bravo"]


def test_no_temporary_file_remains_while_a_bundle_runs(tmp_path: Path, folder: Path) -> None:
    """The process that runs it may be killed without a cleanup."""
    with cached_bundle(BuildRequest(write_plain(tmp_path / "here"))) as path:
        assert sorted(found.suffix for found in folder.iterdir()) == [".lfm", ".made"]
        assert path.parent == folder


@pytest.mark.few(0)
def test_other_options_give_another_bundle(tmp_path: Path, built: list[BuildRequest]) -> None:
    deploy = write_rich(tmp_path / "here")
    found = {bytes_of(BuildRequest(deploy, simulate=simulate)) for simulate in (False, True)}
    assert len(found) == len(built) == 2


def test_a_change_of_any_file_causes_a_build(tmp_path: Path, folder: Path, built: list[BuildRequest]) -> None:
    deploy = write_rich(tmp_path / "here")
    order = BuildRequest(deploy)
    before = bytes_of(order)
    for ending in (".dL", ".devices.yaml", ".capabilities.yaml", ".L"):
        path = deploy.with_suffix(ending)
        text = path.read_text()
        path.write_text(text + ("\n// more" if ending == ".L" else "\n# more"))
        assert build_cache._find(folder, order) is None, ending
        path.write_text(text)
        assert build_cache._find(folder, order) is not None, ending
    path.write_text(text + "\n// more")
    assert bytes_of(order) != before, "the sources are in it"
    assert len(built) == 2


def test_a_new_file_causes_a_build(tmp_path: Path, built: list[BuildRequest]) -> None:
    deploy = write_plain(tmp_path / "here")
    order = BuildRequest(deploy)
    bytes_of(order)
    deploy.with_suffix(".devices.yaml").write_text("unreachable_after: 5\n")
    with cached_bundle(order) as path:
        assert bundle.read(path).bindings.unreachable_after == 5.0
    assert len(built) == 2


@pytest.mark.few(0)
def test_only_python_modules_of_a_module_folder_count(
    tmp_path: Path, built: list[BuildRequest], monkeypatch: pytest.MonkeyPatch
) -> None:
    modules = tmp_path / "modules"
    modules.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(modules))
    # Only a process of its own reads the variable.
    monkeypatch.setattr(build_cache, "subprocess", subprocess)
    order = BuildRequest(write_plain(tmp_path / "here"))
    bytes_of(order)
    # Tools leave caches in their working folder.
    (modules / ".cache").mkdir()
    (modules / "__pycache__").mkdir()
    bytes_of(order)
    assert len(built) == 1
    (modules / "new.py").write_text("")
    bytes_of(order)
    assert len(built) == 2


@pytest.mark.few(0)
def test_a_changed_included_file_causes_a_build(tmp_path: Path, built: list[BuildRequest]) -> None:
    deploy = write_plain(tmp_path / "here")
    deploy.with_suffix(".L").write_text('include "more.L";\n' + PLAIN)
    (deploy.parent / "more.L").write_text("class More { public int a; }")
    order = BuildRequest(deploy)
    first = bytes_of(order)
    (deploy.parent / "more.L").write_text("class More { public int b; }")
    assert bytes_of(order) != first
    assert len(built) == 2


def test_a_modified_cached_bundle_is_built_again(
    tmp_path: Path, folder: Path, built: list[BuildRequest]
) -> None:
    order = BuildRequest(write_plain(tmp_path / "here"))
    good = bytes_of(order)
    (path,) = folder.glob("*.lfm")
    path.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    assert bytes_of(order) == good
    (folder / f"{order.key}.made").write_bytes(b"\xc1 nothing")
    assert bytes_of(order) == good
    other = bytes_of(BuildRequest(write_rich(tmp_path / "there")))
    path.write_bytes(other)
    assert bytes_of(order) == good
    assert len(built) == 5


def test_the_cache_folder_is_private_to_the_user(
    tmp_path: Path, folder: Path, built: list[BuildRequest]
) -> None:
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    order = BuildRequest(write_plain(tmp_path / "here"))
    folder.chmod(0o770)
    assert cache_folder() is None
    with cached_bundle(order) as path:
        assert folder not in path.parents
        assert bundle.read(path).name == "mission"
    assert not path.exists(), "built for this once"
    bytes_of(order)
    assert len(built) == 2
    assert list(folder.iterdir()) == []


def test_mistakes_in_files_are_reported_by_the_build_process(
    tmp_path: Path, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    deploy = write_rich(tmp_path / "here")
    deploy.with_suffix(".capabilities.yaml").write_text(CAPABILITIES.replace("hoist", "rise"))
    with pytest.raises(BuildFailed) as error, cached_bundle(BuildRequest(deploy)):
        pytest.fail("there is nothing to run")
    assert error.value.status == 65
    assert "error[C" in capfd.readouterr().err
    assert list(folder.iterdir()) == []


@pytest.mark.few(0)
def test_the_oldest_bundles_are_removed(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build_cache, "MAX_BUNDLES", 1)
    first, second = BuildRequest(write_plain(tmp_path / "here")), BuildRequest(write_rich(tmp_path / "there"))
    bytes_of(first)
    for path in folder.iterdir():
        os.utime(path, (1.0, 1.0))
    killed, busy, started = (folder / f"building-{name}" for name in ("killed", "busy", "begun"))
    for workshop in (killed, busy, started):
        workshop.mkdir(0o700)
        (workshop / "inputs").touch()
    for workshop in (killed, busy):
        os.utime(workshop, (time.time() - 100.0,) * 2)
    with lock_private_folder(busy):
        bytes_of(second)
    assert [workshop.exists() for workshop in (killed, busy, started)] == [False, True, True]
    assert len(list(folder.glob("*.lfm"))) == len(list(folder.glob("*.made"))) == 1
    assert (folder / f"{second.key}.made").exists()


@pytest.mark.few(0)
def test_a_bundle_gets_other_bindings(tmp_path: Path, built: list[BuildRequest]) -> None:
    deploy = write_rich(tmp_path / "here")
    file = tmp_path / "mission.lfm"
    file.write_bytes(bytes_of(BuildRequest(deploy)))
    devices = tmp_path / "robot.yaml"
    text = deploy.with_suffix(".devices.yaml").read_text().replace("ttyUSB0", "ttyACM7")
    devices.write_text(text)
    with cached_bundle(BuildRequest(file, devices=devices)) as path:
        assert bundle.read(path).bindings.devices["small"]["boom"].endpoint == "serial:/dev/ttyACM7:57600"
        parts = bundle.contents(path.read_bytes()).table
    before = bundle.contents(file.read_bytes()).table
    assert [a.name for a, b in zip(before, parts, strict=True) if a != b] == ["bindings"]
    devices.write_text("agents: {small: {devices: {boom: {driver: servo}}}}")
    with pytest.raises(BuildFailed), cached_bundle(BuildRequest(file, devices=devices)):
        pytest.fail("that driver is not in the bundle")


def test_a_damaged_bundle_gets_no_other_bindings(tmp_path: Path) -> None:
    file = tmp_path / "mission.lfm"
    file.write_bytes(b"LFMB")
    with pytest.raises(BundleError):
        bundle.read(file)
    with (
        pytest.raises(BuildFailed) as error,
        cached_bundle(BuildRequest(file, devices=tmp_path / "none.yaml")),
    ):
        pytest.fail("there is nothing to run")
    assert error.value.status == 65


def test_a_user_without_a_home_has_no_cache(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "relative")
    monkeypatch.setattr(os, "getuid", lambda: 54321)  # no user of this computer
    assert cache_folder() is None
