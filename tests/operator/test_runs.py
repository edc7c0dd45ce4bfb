"""The folders of runs: access, untrusted manifests, and remains of killed runs."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pytest

from lfield.errors import OutputFileError
from lfield.operator import run_dirs, runs
from lfield.operator.run_dirs import RunLocation, unreadable_hint
from lfield.operator.runs import RunManifest, no_runs_hint, publish_run, runs_here
from lfield.text import user_dirs

DEPLOYMENT = b"d" * 32
ADDRESSES = {"alpha": "127.0.0.1:4001", "bravo": "127.0.0.1:4002"}
NOTE = RunManifest("/m/tour.dL", DEPLOYMENT.hex(), 7, 10.5, 120.0, ADDRESSES, {"alpha": "alpha.sock"})


@pytest.fixture
def tmp_path():
    """Not pytest's folder: the path of a socket has at most 107 bytes."""
    with tempfile.TemporaryDirectory(prefix="lf-") as path:
        yield Path(path)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder of this user's runs."""
    for name in ("shared", "run"):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.setattr(run_dirs, "SERVICE", tmp_path / "run" / "lfield")
    monkeypatch.setattr(run_dirs, "SESSIONS", tmp_path / "run" / "user")
    monkeypatch.setattr(user_dirs, "SHARED", tmp_path / "shared")
    # Runs open to the group are in test_places.
    monkeypatch.setattr(run_dirs, "shared_group_id", lambda: None)
    monkeypatch.delenv("LFIELD_RUNS", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return tmp_path / "lfield"


@pytest.fixture
def service(tmp_path, monkeypatch):
    """The folder that a service manager has made."""
    made = tmp_path / "run" / "lfield"
    made.mkdir(mode=0o750)
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"/run/other:{made}")
    return made


def begun(note: RunManifest = NOTE):
    return publish_run(note, pytest.fail)


def mode(path: Path) -> int:
    return path.lstat().st_mode & 0o777


def changed(**fields) -> RunManifest:
    return msgspec.structs.replace(NOTE, **fields)


def test_a_run_is_found_while_it_is_alive():
    assert runs_here() == []
    with begun() as addresses:
        (run,) = runs_here()
        assert run.manifest == NOTE
        assert re.fullmatch("tour-[0-9a-f]{8}", run.id)
        assert dict(addresses.addresses) == {"alpha": f"unix:{run.folder}/alpha.sock"}
        assert (run.control_socket("alpha"), run.control_socket("bravo")) == (
            addresses.addresses["alpha"],
            "",
        )
    assert runs_here() == []


def test_only_its_user_can_read_a_run_and_nothing_remains_of_it(folder):
    with begun():
        (run,) = folder.iterdir()
        (note,) = run.iterdir()
        assert (mode(folder), mode(run), mode(note)) == (0o700, 0o700, 0o600)
        (run / "alpha.sock").touch()
    assert list(folder.iterdir()) == []


def test_two_runs_of_one_mission_are_independent():
    with begun() as first:
        with begun(changed(started=11.0)) as second:
            assert [run.manifest.started for run in runs_here()] == [10.5, 11.0]
            assert first.addresses != second.addresses
        assert [run.manifest.started for run in runs_here()] == [10.5]


def test_a_run_that_no_command_could_find_does_not_start(folder):
    """No command could stop such a run, with any keys."""
    folder.write_text("a file, not a folder")
    with pytest.raises(OutputFileError) as error, begun():
        pytest.fail("it runs")
    assert str(error.value) == (
        f"cannot write {folder}: it is not a folder; no command could find what runs, to stop it: set "
        "XDG_RUNTIME_DIR to another folder of your own, or remove what is in the way"
    )


def test_a_folder_prepared_by_another_user_is_not_used(folder, tmp_path):
    """A link or a directory that others can write to is not used."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    folder.symlink_to(elsewhere)
    with pytest.raises(OutputFileError, match="it is a link"), begun():
        pytest.fail("it runs")
    assert list(elsewhere.iterdir()) == []
    folder.unlink()
    with begun():
        folder.chmod(0o777)
        assert runs_here() == []
        folder.chmod(0o700)
        assert len(runs_here()) == 1


def test_a_run_that_others_could_have_changed_is_not_trusted(folder):
    with begun():
        (run,) = folder.iterdir()
        for path in (folder, run, run / "note.json"):
            usual = mode(path)
            path.chmod(usual | 0o020)
            assert runs_here() == []
            path.chmod(usual)
        assert len(runs_here()) == 1


def test_a_link_in_place_of_a_manifest_or_run_is_not_trusted(folder, tmp_path):
    with begun():
        (run,) = folder.iterdir()
        (run / "note.json").rename(tmp_path / "note.json")
        (run / "note.json").symlink_to(tmp_path / "note.json")
        assert runs_here() == []
        (run / "note.json").unlink()
        (tmp_path / "note.json").rename(run / "note.json")
        (folder / "tour-00000000").symlink_to(run)
        assert [found.folder for found in runs_here()] == [run]


def test_remains_of_a_killed_run_are_removed(folder):
    """A socket and manifest remain, the lock does not."""
    left = folder / "tour-0123abcd"
    left.mkdir(mode=0o700, parents=True)
    folder.chmod(0o700)
    (left / "note.json").write_bytes(msgspec.json.encode(changed(pid=os.getpid())))
    (left / "alpha.sock").touch()
    unfinished, beginning = folder / f".{'0' * 16}", folder / f".{'1' * 16}"
    for path in (unfinished, beginning):
        path.mkdir()
    os.utime(unfinished, (time.time() - 3600, time.time() - 3600))
    (folder / "of-somebody-else").mkdir()
    assert runs_here() == []
    assert {path.name for path in folder.iterdir()} == {beginning.name, "of-somebody-else"}


def test_a_run_is_alive_while_a_process_that_inherited_its_lock_is(folder):
    """The hosts of `up --all` whose parent was killed land their vehicles and answer."""
    run, lock = runs._create(NOTE, pytest.fail)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[lock])
    os.close(lock)
    assert [found.folder for found in runs_here()] == [run.folder]
    child.communicate(b"\n")
    assert runs_here() == []
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("mission.dL", "mission"),
        ("/a/.hidden.lfm", "hidden"),
        ("a b/ü ;$(x).dL", "_____x_"),
        ("x" * 200 + ".dL", "x" * 24),
        ("....dL", "run"),
    ],
)
def test_mission_names_become_valid_folder_names(file, name):
    with begun(changed(mission=file)):
        (run,) = runs_here()
        assert run.id.rpartition("-")[0] == name
        assert run.manifest.mission == file


@dataclass
class Mission:
    """The part of a mission that a run publishes."""

    hosts: dict[str, str]
    bindings: object = field(default_factory=lambda: type("Bindings", (), {"all": []}))

    @property
    def team(self):
        return type("Team", (), {"deployment": DEPLOYMENT, "addresses_by_host": self.hosts})


def test_unusual_host_names_have_safe_socket_names():
    hosts = ["alpha", "10.0.0.7", "a/../b", "fe80::1", "x" * 64, "-"]
    note = runs.run_manifest(Mission(dict.fromkeys(hosts, "h:1")), Path("tour.dL"), hosts)
    assert Path(note.mission).is_absolute()
    assert list(note.control_sockets.values()) == [
        "alpha.sock",
        "10.0.0.7.sock",
        "+2.sock",
        "+3.sock",
        "+4.sock",
        "+5.sock",
    ]
    with begun(note):
        (run,) = runs_here()
        assert run.manifest.control_sockets == note.control_sockets


def test_a_folder_too_deep_for_sockets_is_refused(tmp_path, monkeypatch):
    deep = tmp_path / ("x" * 90)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    with pytest.raises(OutputFileError, match="too long for a socket; set XDG_RUNTIME_DIR"), begun():
        pytest.fail("it runs")
    assert list(deep.iterdir()) == []


def test_the_runtime_folder_of_another_user_is_not_used(folder, tmp_path, monkeypatch):
    """XDG_RUNTIME_DIR may be left from before `su`."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/proc/1" if os.geteuid() else str(tmp_path / "gone"))
    with begun():
        (run,) = runs_here()
        assert run.folder.parent == tmp_path / "shared" / f"lfield-{os.geteuid()}"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with begun():
        assert [run.folder.parent for run in runs_here()] == [folder]


def test_a_login_with_another_environment_finds_the_run(tmp_path, monkeypatch):
    """cron and sudo set no XDG_RUNTIME_DIR."""
    user = os.geteuid()
    runtime = tmp_path / "run" / "user" / str(user)
    runtime.mkdir(mode=0o700, parents=True)
    where = {"runtime": runtime / "lfield", "shared": tmp_path / "shared" / f"lfield-{user}"}
    with monkeypatch.context() as login:
        login.setenv("XDG_RUNTIME_DIR", str(runtime))
        in_runtime = begun()
        in_runtime.__enter__()
        login.delenv("XDG_RUNTIME_DIR")
        in_shared = begun(changed(started=11.0))
        in_shared.__enter__()
    try:
        for name in ("", str(tmp_path)):
            monkeypatch.setenv("XDG_RUNTIME_DIR", name)
            assert [run.folder.parent for run in runs_here()] == list(where.values())
        monkeypatch.setenv("LFIELD_RUNS", "here")
        assert runs_here() == []
    finally:
        in_runtime.__exit__(None, None, None)
        in_shared.__exit__(None, None, None)


def owned(folder: Path, user: int) -> None:
    for path in (folder, *folder.rglob("*")):
        os.chown(path, user, user)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make what belongs to others")
@pytest.mark.parametrize("place", ["run/user/4242/lfield", "shared/lfield-4242"])
def test_root_finds_runs_of_other_users_only_under_their_own_name(tmp_path, monkeypatch, place):
    base = tmp_path / place
    base.parent.mkdir(parents=True, exist_ok=True)
    with monkeypatch.context() as login:
        login.setattr(runs, "run_locations", lambda: [RunLocation(base)])
        run, lock = runs._create(NOTE, pytest.fail)
    try:
        owned(base, 4242)
        (found,) = runs_here()
        assert (found.folder, found.id, found.user) == (run.folder, f"4242/{run.folder.name}", "4242")
        os.chown(run.folder / "note.json", 4243, 4243)
        assert runs_here() == []
        owned(base, 4243)
        assert runs_here() == []
        owned(base, 4242)
        base.chmod(0o777)
        assert runs_here() == []
        base.chmod(0o700)
        monkeypatch.setattr(os, "geteuid", lambda: 4244)
        assert runs_here() == []
    finally:
        os.close(lock)


@pytest.fixture
def of_others(tmp_path, monkeypatch):
    """A function that creates a run of user 4242, as its process does."""
    base = tmp_path / "shared" / "lfield-4242"
    base.parent.mkdir(parents=True, exist_ok=True)
    locks = []

    def make(**fields):
        with monkeypatch.context() as login:
            login.setattr(runs, "run_locations", lambda: [RunLocation(base)])
            os.chown(base, 0, 0) if base.exists() else None
            run, lock = runs._create(changed(**fields), pytest.fail)
        locks.append(lock)
        owned(base, 4242)
        return run

    yield make
    for lock in locks:
        os.close(lock)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make what belongs to others")
def test_the_owner_of_a_run_is_that_of_its_file_and_not_of_its_manifest(of_others):
    """Claims of another user come last, even with an earlier start time."""
    of_others(started=1.0)
    with begun():
        own, other = runs_here()
    assert (own.owner, own.user, own.is_foreign) == ("root", "", False)
    assert (other.owner, other.user, other.is_foreign) == ("4242", "4242", True)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make what belongs to others")
def test_manifests_of_another_user_are_limited_to_the_size_of_one(of_others, monkeypatch):
    for _ in range(5):
        size = len(msgspec.json.encode(of_others().manifest))
    with begun():
        monkeypatch.setattr(runs, "_MAX_MANIFEST", 3 * size + 1)
        assert [run.is_foreign for run in runs_here()] == [False, True, True, True]
        monkeypatch.setattr(runs, "_MAX_FOREIGN", 2)
        assert [run.is_foreign for run in runs_here()] == [False, True, True]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make what belongs to others")
def test_a_fifo_in_place_of_a_manifest_does_not_block(of_others):
    note = of_others().folder / "note.json"
    note.unlink()
    os.mkfifo(note)
    os.chown(note, 4242, 4242)
    assert runs_here() == []


def test_the_hint_without_a_run_names_the_searched_folders(tmp_path, monkeypatch):
    hint = no_runs_hint()
    for place in (
        tmp_path / "lfield",
        tmp_path / "run" / "lfield",
        tmp_path / "shared" / f"lfield-{os.geteuid()}",
    ):
        assert str(place) in hint
    assert "another XDG_RUNTIME_DIR, set this variable" in hint
    assert (str(tmp_path / "shared" / "lfield-*") in hint) == (os.geteuid() == 0)


def test_a_service_shows_its_runs_to_its_group(service, folder):
    with begun(), begun(changed(started=11.0)):
        assert not folder.exists()
        assert [run.folder.parent for run in runs_here()] == [service, service]
        (first, _) = service.iterdir()
        assert (mode(first), mode(first / "note.json")) == (0o750, 0o640)
    assert list(service.iterdir()) == []


def test_a_lock_on_the_manifest_of_a_killed_run_does_not_keep_it_listed(service):
    """A member of the group may open folder and manifest, and lock both for reading."""
    run, lock = runs._create(NOTE, pytest.fail)
    held = [os.open(path, os.O_RDONLY) for path in (run.folder, run.folder / "note.json")]
    for opened in held:
        fcntl.flock(opened, fcntl.LOCK_SH)
    fcntl.fcntl(held[1], fcntl.F_OFD_SETLK, runs._LOCK.pack(fcntl.F_UNLCK, 0, 0, 0, 0))
    assert len(runs_here()) == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        fcntl.fcntl(held[1], fcntl.F_OFD_SETLK, runs._LOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
    os.close(lock)
    fcntl.fcntl(held[1], fcntl.F_OFD_SETLK, runs._LOCK.pack(fcntl.F_RDLCK, 0, 0, 0, 0))
    fcntl.flock(held[0], fcntl.LOCK_EX)
    assert runs_here() == []
    assert not run.folder.exists()
    for opened in held:
        os.close(opened)


def test_a_run_that_cannot_be_examined_is_not_removed(folder, monkeypatch):
    """A command without descriptors must not remove the sockets of a running mission."""
    with begun():
        (run,) = folder.iterdir()
        real = os.open

        def full(path, *args, **options):
            if str(path).endswith("note.json"):
                raise OSError(errno.EMFILE, "Too many open files")
            return real(path, *args, **options)

        with monkeypatch.context() as out:
            out.setattr(os, "open", full)
            assert runs_here() == []
        assert [found.folder for found in runs_here()] == [run]


def test_a_command_finds_the_runs_of_the_service_and_its_own(service, monkeypatch):
    with begun():
        monkeypatch.delenv("RUNTIME_DIRECTORY")
        with begun(changed(started=11.0)):
            assert [run.manifest.started for run in runs_here()] == [10.5, 11.0]
        service.parent.chmod(0o777)
        assert runs_here() == []


def test_an_unreadable_service_folder_is_reported(service, monkeypatch):
    assert unreadable_hint() == ""
    monkeypatch.setattr(os, "access", lambda path, how: False)
    assert unreadable_hint().startswith(f"what runs in {service} this user may not see: use sudo")
    service.rmdir()
    assert unreadable_hint() == ""


@pytest.mark.parametrize(
    "note",
    [
        "",
        "{",
        "[]",
        '{"pid": 7}',
        "\xff",
        "[" * 100_000,
        *(
            json.dumps(msgspec.to_builtins(NOTE) | wrong)
            for wrong in (
                {"pid": 0},
                {"pid": "7"},
                {"pid": 10**20},
                {"started": float("1e300")},
                {"deployment": "d"},
                {"addresses": ["127.0.0.1:1"]},
                {"addresses": {"alpha": 1}},
                {"addresses": {"": "127.0.0.1:1"}},
                {"addresses": {"alpha": "1" * 300}},
                {"addresses": {"alpha": "unix:/run/other.sock"}},
                {"addresses": {"alpha": "fd:3"}},
                {"addresses": {f"h{number}": "127.0.0.1:1" for number in range(4097)}},
                {"user": "root"},
                {"doors": {"alpha": "../alpha.sock"}},
                {"doors": {"alpha": "/alpha.sock"}},
                {"doors": {"alpha": ".."}},
                {"more": 1},
            )
        ),
    ],
)
def test_an_invalid_manifest_is_not_trusted(folder, note):
    with begun():
        (run,) = folder.iterdir()
        (run / "note.json").write_text(note, encoding="latin-1")
        assert runs_here() == []
