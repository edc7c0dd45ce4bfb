"""Wheels for robots: the lock file, platforms, the cache, lfield's own wheel, and a standalone Python."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import msgspec
import pytest

from lfield.errors import DamagedFileError, ProvisionError
from lfield.provision import standalone_python, wheel_cache
from lfield.provision.lock_file import Pin, Wheel, needed_pins, pip_lock, read_lock, text_digest
from lfield.provision.own_wheel import deployment_file, describe_wheel, make_own_wheel, repack
from lfield.provision.standalone_python import collect_python
from lfield.provision.wheel_cache import LOCK, WheelCache, WheelCollection
from lfield.provision.wheel_target import ARCHITECTURES, PYTHONS, WheelTarget

PI = WheelTarget("aarch64", "3.11")
PINS = read_lock(deployment_file(LOCK).decode(), LOCK)


def names(pins: list[Pin]) -> set[str]:
    return {pin.name for pin in pins}


# --- the lock file ------------------------------------------------------------------------------------------


def test_lock_has_hashes_and_pip():
    assert "pip" in names(PINS)
    assert all(pin.hashes for pin in PINS)


@pytest.mark.parametrize(("arch", "has_engine"), [("aarch64", True), ("x86_64", True), ("armv7l", False)])
def test_markers_are_evaluated_for_the_robot(arch, has_engine):
    found = names(needed_pins(PINS, WheelTarget(arch, "3.11")))
    assert ("wasmtime" in found) is has_engine
    assert {"lxml", "pymavlink", "uvloop"} <= found


def test_lock_line_without_a_version_is_refused():
    with pytest.raises(DamagedFileError):
        read_lock("rich>=13\n", "lock.txt")


def test_pip_lock_text_is_parsed_to_the_same_pins():
    pins = [Pin("a", "1.0", "", frozenset({"0" * 64, "f" * 64}))]
    assert pip_lock(pins) == f"a==1.0 --hash=sha256:{'0' * 64} --hash=sha256:{'f' * 64}\n"
    assert read_lock(pip_lock(pins), "") == pins


# --- platforms ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("cffi-2.1.1-cp311-cp311-manylinux_2_17_aarch64.manylinux2014_aarch64.whl", True),
        ("cffi-2.1.1-cp311-cp311-linux_aarch64.whl", True),
        ("cryptography-50.0.2-cp39-abi3-manylinux_2_28_aarch64.whl", True),
        ("cryptography-50.0.2-cp312-abi3-manylinux_2_28_aarch64.whl", False),
        ("rich-15.0.0-py3-none-any.whl", True),
        ("pyserial-3.5-py2.py3-none-any.whl", True),
        ("cffi-2.1.1-cp312-cp312-linux_aarch64.whl", False),
        ("cffi-2.1.1-cp311-cp311-linux_armv7l.whl", False),
        ("notes.txt", False),
    ],
)
def test_custom_wheel_must_match_the_platform(file, expected):
    assert PI.accepts(file) is expected


def test_pip_options_name_the_platform():
    options = list(PI.pip_options())
    assert "manylinux_2_28_aarch64" in options
    assert "manylinux_2_39_aarch64" not in options
    assert options[-6:] == ["--abi", "cp311", "--abi", "abi3", "--abi", "none"]


def test_wheels_and_standalone_python_have_the_same_architectures():
    assert set(ARCHITECTURES) == {"aarch64", "armv7l", "x86_64"}
    assert standalone_python.ARCHITECTURES is ARCHITECTURES
    assert PYTHONS == ("3.13", "3.12", "3.11")


# --- the cache ----------------------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch) -> WheelCache:
    """A wheel cache with a folder of custom wheels, and a file in place of lfield's own wheel."""

    async def own(folder: Path) -> Path:
        path = folder / "lfield-0.4.0-py3-none-any.whl"
        path.write_bytes(b"lfield")
        return path

    monkeypatch.setattr(wheel_cache, "make_own_wheel", own)
    wheels = WheelCache(tmp_path / "cache", tmp_path / "custom")
    yield wheels
    wheels.close()


class Index:
    """Replaces `pip download`: counts requests, and lacks the `missing` packages."""

    def __init__(self, *missing: str) -> None:
        self.missing, self.requests = set(missing), 0

    async def download(self, *arguments: str, operation: str) -> None:
        self.requests += 1
        folder, lock = Path(arguments[arguments.index("-d") + 1]), Path(arguments[arguments.index("-r") + 1])
        pins = read_lock(lock.read_text(), "")
        if names(pins) & self.missing:
            raise ProvisionError("", f"{operation}: no matching distribution")
        for pin in pins:
            (folder / f"{pin.name.replace('-', '_')}-{pin.version}-py3-none-any.whl").write_text(pin.name)


def collect(cache: WheelCache, target: WheelTarget = PI):
    async def collect_twice():
        # Two robots of one platform request the wheels at the same time.
        return await asyncio.gather(*(cache.payload(target, brings_python=False) for _ in range(2)))

    first, second = asyncio.run(collect_twice())
    assert first is second
    return first


def test_each_platform_is_collected_once(cache, monkeypatch, tmp_path):
    index = Index()
    monkeypatch.setattr(wheel_cache, "run_pip", index.download)
    payload = collect(cache)
    assert index.requests == 1
    assert len(payload.wheels) == len(needed_pins(PINS, PI))
    assert not any("zenoh" in wheel.file for wheel in payload.wheels)
    assert payload.lock.count("--hash=sha256:") == len(payload.wheels)
    assert all(describe_wheel(payload.path(wheel)) == wheel for wheel in payload.wheels)
    second_cache = WheelCache(tmp_path / "cache")
    assert collect(second_cache).environment == payload.environment
    assert index.requests == 1
    second_cache.close()


def test_robots_in_a_fabric_also_get_the_zenoh_package(monkeypatch, cache, tmp_path):
    monkeypatch.setattr(wheel_cache, "run_pip", Index().download)
    payload = collect(cache)
    in_fabric = WheelCache(tmp_path / "fabric", has_zenoh=True)
    additional = {wheel.file for wheel in collect(in_fabric).wheels} - {
        wheel.file for wheel in payload.wheels
    }
    assert [file.partition("-")[0] for file in additional] == ["eclipse_zenoh"]
    in_fabric.close()


def test_damaged_wheel_is_collected_again(cache, monkeypatch, tmp_path):
    index = Index()
    monkeypatch.setattr(wheel_cache, "run_pip", index.download)
    payload = collect(cache)
    (payload.folder / "rich-15.0.0-py3-none-any.whl").write_text("cut")
    second_cache = WheelCache(tmp_path / "cache")
    assert collect(second_cache).wheels == payload.wheels
    assert index.requests == 2
    second_cache.close()


def test_every_missing_wheel_is_named(cache, monkeypatch):
    index = Index("cffi", "msgspec")
    monkeypatch.setattr(wheel_cache, "run_pip", index.download)
    with pytest.raises(ProvisionError) as found:
        collect(cache, WheelTarget("armv7l", "3.11"))
    assert "cffi==" in found.value.reason
    assert "msgspec==" in found.value.reason
    assert "--wheels" in found.value.advice


def test_custom_wheels_replace_missing_ones(cache, monkeypatch, tmp_path):
    index = Index("cffi")
    monkeypatch.setattr(wheel_cache, "run_pip", index.download)
    (version,) = (pin.version for pin in PINS if pin.name == "cffi")
    (tmp_path / "custom").mkdir()
    file = f"cffi-{version}-cp311-cp311-linux_aarch64.whl"
    (tmp_path / "custom" / file).write_text("made on a robot")
    (tmp_path / "custom" / "cffi-0.1-cp311-cp311-linux_aarch64.whl").write_text("too old")
    payload = collect(cache)
    assert [wheel.file for wheel in payload.wheels if wheel.file.startswith("cffi")] == [file]


def test_missing_package_index_suggests_prepare(cache, monkeypatch):
    index = Index(*names(PINS))
    monkeypatch.setattr(wheel_cache, "run_pip", index.download)
    with pytest.raises(ProvisionError) as found:
        collect(cache)
    assert "--prepare" in found.value.advice


# --- lfield's own wheel -------------------------------------------------------------------------------------


@pytest.mark.few(0)
@pytest.mark.process
def test_installed_lfield_rebuilds_its_own_wheel(tmp_path):
    first_build, installed, second_build = (tmp_path / name for name in ("first", "installed", "second"))
    for folder in (first_build, second_build):
        folder.mkdir()
    wheel = asyncio.run(make_own_wheel(first_build))
    assert describe_wheel(asyncio.run(make_own_wheel(second_build))).sha256 == describe_wheel(wheel).sha256
    (second_build / wheel.name).unlink()
    arguments = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", installed, wheel]
    subprocess.run([sys.executable, *map(str, arguments)], check=True, timeout=110)
    # The installed lfield has neither sources nor a checkout.
    script = (
        "import asyncio, pathlib, sys; "
        "from lfield.provision.own_wheel import make_own_wheel, deployment_file; "
        "print(asyncio.run(make_own_wheel(pathlib.Path(sys.argv[1])))); "
        "print(deployment_file('lfield.service') and deployment_file('locks/run.txt') and 'complete')"
    )
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    arguments = [sys.executable, "-P", "-c", script, str(second_build)]
    done = subprocess.run(
        arguments, env=environment, cwd=tmp_path, check=True, timeout=60, capture_output=True, text=True
    )
    path, complete = done.stdout.splitlines()
    assert (Path(path).name, complete) == (wheel.name, "complete")
    first, second = (zipfile.ZipFile(name) for name in (wheel, path))
    assert sorted(first.namelist()) == sorted(second.namelist())
    assert all(
        first.read(name) == second.read(name) for name in first.namelist() if not name.endswith("/RECORD")
    )


def test_changed_file_of_an_installed_package_is_refused(tmp_path):
    folder = tmp_path / "thing-1.0.dist-info"
    folder.mkdir()
    (tmp_path / "thing.py").write_text("changed")
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n")
    (folder / "WHEEL").write_text("Wheel-Version: 1.0\nTag: py3-none-any\n")
    (folder / "RECORD").write_text("thing.py,sha256=AAAA,7\nthing-1.0.dist-info/METADATA,,\n")
    from importlib.metadata import PathDistribution

    with pytest.raises(ProvisionError, match="was changed"):
        repack(PathDistribution(folder), tmp_path)
    (folder / "RECORD").write_text("thing.py,,\ngone.py,,\n")
    with pytest.raises(ProvisionError, match="is missing"):
        repack(PathDistribution(folder), tmp_path)


def test_repacked_dependency_is_a_complete_wheel(tmp_path):
    path = repack(distribution("rich"), tmp_path)
    assert path.name == f"rich-{distribution('rich').version}-py3-none-any.whl"
    listed = zipfile.ZipFile(path).namelist()
    assert "rich/console.py" in listed
    assert not [name for name in listed if "__pycache__" in name or name.endswith("/INSTALLER")]


# --- a Python for the robot ---------------------------------------------------------------------------------


def _uv(folder: Path, body: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "uv").write_text(f"#!/bin/sh\n{body}\n")
    (folder / "uv").chmod(0o755)


def test_standalone_python_is_collected_with_uv_once(tmp_path, monkeypatch):
    _uv(
        tmp_path / "bin",
        'echo "$*" >>"$(dirname "$0")/calls"; build=cpython-3.12.9-linux-aarch64-gnu; '
        'mkdir -p "$6/$build/bin"; echo binary >"$6/$build/bin/python3.12"; ln -s $build "$6/cpython-3.12"',
    )
    monkeypatch.setattr(standalone_python, "find_uv", lambda: str(tmp_path / "bin/uv"))
    target = WheelTarget("aarch64", "3.12")
    found = asyncio.run(collect_python(tmp_path / "python", target))
    assert found.version == "3.12.9"
    assert found.archive.name == "aarch64-3.12.9.tar.gz"
    assert asyncio.run(collect_python(tmp_path / "python", target)) == found
    (call,) = (tmp_path / "bin/calls").read_text().splitlines()
    assert call.endswith("cpython-3.12-linux-aarch64-gnu")
    assert [path.name for path in (tmp_path / "python").iterdir()] == [found.archive.name]


def test_uv_error_is_reported_with_the_remedy(tmp_path, monkeypatch):
    _uv(tmp_path / "bin", "echo 'error: no network' >&2; exit 1")
    monkeypatch.setattr(standalone_python, "find_uv", lambda: str(tmp_path / "bin/uv"))
    with pytest.raises(ProvisionError) as found:
        asyncio.run(collect_python(tmp_path / "python", WheelTarget("aarch64", "3.12")))
    assert "no network" in found.value.reason
    assert "UV_PYTHON_INSTALL_MIRROR" in found.value.advice


def test_collection_index_is_named_after_its_lock(tmp_path):
    """Each lock file has its own collection index in the folder of the platform."""
    pins = needed_pins(PINS, PI)
    assert text_digest(pip_lock(pins)) != text_digest(pip_lock(pins[1:]))
    wheel = Wheel("a-1.0-py3-none-any.whl", "0" * 64, 1)
    data = msgspec.json.encode(WheelCollection((wheel,)))
    assert msgspec.json.decode(data, type=WheelCollection).wheels == (wheel,)
