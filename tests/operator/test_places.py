"""The directories of runs: no other user can change them; they are open to the group where possible."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from lfield.errors import OutputFileError
from lfield.net import peer_credentials
from lfield.operator import run_dirs, runs
from lfield.operator.run_dirs import run_locations, search_roots, searched_dirs
from lfield.operator.runs import RunManifest, publish_run, runs_here
from lfield.text import user_dirs

NOTE = RunManifest(
    "/m/tour.dL", "d" * 64, 7, 10.5, 120.0, {"alpha": "127.0.0.1:4001"}, {"alpha": "alpha.sock"}
)
# : Users of these tests by number, and the group `lfield` in them.
ALICE, BOB, MALLORY, GROUP = 4242, 4243, 4244, 4999
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be other users")


@pytest.fixture(autouse=True)
def tmp_path(monkeypatch) -> Iterator[Path]:
    """The folders /tmp and /run/user of the test; this user has no runtime folder."""
    # Not pytest's folder: other users may not enter it, and a socket path has at most 107 bytes.
    with tempfile.TemporaryDirectory(prefix="lf-") as path:
        made = Path(path)
        made.chmod(0o755)
        (made / "shared").mkdir()
        (made / "shared").chmod(0o1777)
        monkeypatch.setattr(user_dirs, "SHARED", made / "shared")
        monkeypatch.setattr(run_dirs, "SESSIONS", made / "user")
        monkeypatch.setattr(run_dirs, "SERVICE", made / "none" / "lfield")
        for name in ("LFIELD_RUNS", "XDG_RUNTIME_DIR", "RUNTIME_DIRECTORY"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(peer_credentials, "_group_id", lambda: None)
        yield made


@pytest.fixture
def shared(tmp_path) -> Path:
    return tmp_path / "shared"


@pytest.fixture
def usual(shared) -> Path:
    return shared / f"lfield-{os.geteuid()}"


@pytest.fixture
def group(monkeypatch) -> int:
    """The group `lfield`, with this user as a member."""
    number = GROUP if os.geteuid() == 0 else os.getegid()
    monkeypatch.setattr(peer_credentials, "_group_id", lambda: number)
    return number


def mode(path: Path) -> int:
    return path.lstat().st_mode & 0o777


def begun(tell: Callable[[str], None] = pytest.fail):
    return publish_run(NOTE, tell)


def owned(path: Path, user: int, rights: int = 0o700, group: int = -1) -> Path:
    """A folder of another user."""
    path.mkdir(parents=True)
    path.chmod(rights)
    os.chown(path, user, group)
    return path


def as_user(user: int, groups: Collection[int], work: Callable[[], object]) -> None:
    """Run a function as another user, in a process; its exception fails the test."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgroups(list(groups))
            os.setresgid(user, user, user)
            os.setresuid(user, user, user)
            work()
            status = 0
        except BaseException as error:  # a child must not continue with its parent's tests
            os.write(2, f"as user {user}: {type(error).__name__}: {error}\n".encode())
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@contextmanager
def begun_by(user: int, groups: Collection[int]) -> Iterator[Path]:
    """The folder of a run that another user has started, with the usual umask."""
    near, far = socket.socketpair()

    def begin() -> None:
        os.umask(0o022)
        run, lock = runs._create(NOTE, lambda text: None)
        socket.send_fds(far, [str(run.folder).encode()], [lock])

    as_user(user, groups, begin)
    data, locks, _, _ = socket.recv_fds(near, 4096, 1)
    try:
        yield Path(data.decode())
    finally:
        for opened in (*locks, near.fileno(), far.fileno()):
            os.close(opened)
        near.detach()
        far.detach()


# --- directories that other users have created ---------------------------------------------------


@pytest.mark.parametrize("taken", ["a link", "a file", "a fifo", "writable", "another user's"])
def test_a_run_is_refused_if_its_directory_is_not_private(usual, shared, taken):
    """As after `mkdir /tmp/lfield-1000` of another user."""
    if taken == "a link":
        usual.symlink_to(shared)
    elif taken == "a file":
        usual.write_text("")
    elif taken == "a fifo":
        os.mkfifo(usual)
    elif taken == "writable":
        usual.mkdir()
        usual.chmod(0o777)
    elif os.geteuid() == 0:
        owned(usual, MALLORY, 0o777)
    else:
        usual.symlink_to("/")
    with pytest.raises(OutputFileError, match="set XDG_RUNTIME_DIR to another folder") as refused, begun():
        pytest.fail("it runs")
    assert refused.value.path == str(usual)
    assert [path.name for path in shared.iterdir()] == [usual.name]
    assert runs_here() == []


def test_a_run_uses_the_session_directory_if_that_of_the_group_is_taken(tmp_path, usual, monkeypatch, group):
    usual.write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    lines = []
    with begun(lines.append):
        assert [run.folder.parent for run in runs_here()] == [tmp_path / "lfield"]
    assert [text.partition(":")[0] for text in lines] == ["members of the group lfield do not find this run"]


def test_a_run_is_refused_where_other_users_could_remove_it(shared):
    shared.chmod(0o777)
    with pytest.raises(OutputFileError, match="others could remove files in it; no command could"), begun():
        pytest.fail("it runs")
    assert list(shared.iterdir()) == []


def test_a_runtime_folder_that_others_may_change_is_not_used(tmp_path, usual, monkeypatch):
    (tmp_path / "runtime").mkdir()
    (tmp_path / "runtime").chmod(0o770)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    with begun():
        assert [run.folder.parent for run in runs_here()] == [usual]


@pytest.mark.parametrize("here", ["", "here"])
@pytest.mark.parametrize("runtime", [True, False])
def test_every_possible_place_of_a_run_is_searched(tmp_path, usual, monkeypatch, group, here, runtime):
    usual.write_text("taken")
    monkeypatch.setenv("LFIELD_RUNS", here)
    (tmp_path / "own").mkdir(mode=0o700)
    if runtime:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "own"))
    locations = list(run_locations())
    assert locations
    for position in locations:
        assert position.path in [path for base in search_roots() for path in base.paths]


@as_root
def test_a_run_is_refused_in_a_directory_of_a_third_user(shared):
    owned(shared / f"lfield-{ALICE}", MALLORY, 0o777)

    def begin() -> None:
        with pytest.raises(OutputFileError, match="belongs to another user"):
            runs._create(NOTE, lambda text: None)

    as_user(ALICE, (), begin)
    assert runs_here() == []


@as_root
def test_only_the_directory_named_after_its_owner_is_searched(shared):
    owned(shared / f"lfield-{MALLORY}", MALLORY)
    for name in (f"lfield-{ALICE}", f"lfield-{MALLORY}-0a1b2c3d", f"lfield-0{MALLORY}", "lfield-x"):
        owned(shared / name, MALLORY)
    (other,) = [base for base in search_roots() if base.is_foreign]
    assert (other.paths, other.owners) == ([shared / f"lfield-{MALLORY}"], {MALLORY})


# --- the group -----------------------------------------------------------------------------------


def test_only_the_run_of_a_member_is_open_to_the_group(usual, tmp_path, monkeypatch, group):
    """The rule holds also with a runtime folder, which other users cannot enter."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    usual.mkdir(mode=0o700)
    (usual / "sims").mkdir(mode=0o700)
    before = os.umask(0o077)
    try:
        with begun():
            (run,) = runs_here()
            assert run.folder.parent == usual
            modes = {path: mode(path) for path in (usual, run.folder, run.folder / "note.json")}
            assert list(modes.values()) == [0o750, 0o750, 0o640]
            assert {path.lstat().st_gid for path in modes} == {group}
            assert mode(usual / "sims") == 0o700
    finally:
        os.umask(before)


def test_a_run_for_this_environment_alone_is_private(tmp_path, monkeypatch, group):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("LFIELD_RUNS", "here")
    with begun():
        (run,) = runs_here()
        assert run.folder.parent == tmp_path / "lfield"
        assert (mode(tmp_path / "lfield"), mode(run.folder)) == (0o700, 0o700)


def test_a_manifest_is_locked_before_a_group_may_read_it(monkeypatch, group):
    """A reader of a file may lock it for reading, and no run would start."""
    real, opened = runs.grant_group_read, []

    def let_read(path: Path, group: int) -> None:
        if path.name == "note.json":
            assert runs._is_locked(path.parent)
            assert mode(path.parent) == 0o700
            opened.append(path)
        real(path, group)

    monkeypatch.setattr(runs, "grant_group_read", let_read)
    with begun():
        assert len(opened) == 1


def test_a_user_who_cannot_share_files_is_told_and_the_run_is_found(monkeypatch, group):
    """The test runs as root of a user namespace."""

    def refused(*arguments: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "fchown", refused)
    monkeypatch.setattr(peer_credentials, "_group_id", lambda: GROUP)
    monkeypatch.setattr(os, "getgroups", lambda: [GROUP])
    lines = []
    with begun(lines.append):
        (run,) = runs_here()
        assert mode(run.folder) == 0o700
    (line,) = lines
    assert line.startswith("members of the group lfield do not find this run: cannot write ")
    assert line.endswith("Operation not permitted")


@as_root
@pytest.mark.parametrize("starter", [0, ALICE])
def test_only_members_find_a_run_of_root_or_a_member(shared, group, starter):
    with begun_by(starter, (GROUP,) if starter else ()) as folder:

        def look() -> None:
            (run,) = runs_here()
            assert run.folder == folder
            assert run.id == (f"{ALICE}/{folder.name}" if starter else folder.name)
            assert run.is_foreign == bool(starter)
            assert str(shared / "lfield-*") in searched_dirs()

        as_user(BOB, (GROUP,), look)

        def look_in_vain() -> None:
            assert runs_here() == []
            with pytest.raises(PermissionError):
                os.listdir(folder.parent)

        as_user(MALLORY, (), look_in_vain)


@as_root
def test_a_member_can_neither_remove_nor_replace_files_of_another(tmp_path, group):
    with begun_by(ALICE, (GROUP,)) as folder:
        tries = (
            lambda: (folder / "note.json").unlink(),
            lambda: (folder / "note.json").write_text(""),
            lambda: (folder / "alpha.sock").touch(),
            lambda: folder.rename(folder.with_name("tour-00000000")),
            lambda: folder.parent.rename(folder.parent.with_name("away")),
            lambda: (folder.parent / "tour-00000000").mkdir(),
            lambda: folder.chmod(0o777),
        )

        def attack() -> None:
            for attempt in tries:
                with pytest.raises(PermissionError):
                    attempt()
            # A member's lock does not hide the run, nor its end.
            held = os.open(folder / "note.json", os.O_RDONLY)
            with pytest.raises(BlockingIOError):
                fcntl.fcntl(held, fcntl.F_OFD_SETLK, runs._LOCK.pack(fcntl.F_RDLCK, 0, 0, 0, 0))
            assert [run.folder for run in runs_here()] == [folder]

        as_user(BOB, (GROUP,), attack)
        assert [run.folder for run in runs_here()] == [folder]


@as_root
def test_a_non_member_has_a_run_of_their_own_that_members_ignore(tmp_path, shared, group):
    with begun_by(MALLORY, ()) as folder:
        assert (mode(folder.parent), mode(folder)) == (0o700, 0o700)
        # Also a folder that is open to all is not used: only the group proves that it belongs to a member.
        for path, rights in ((folder.parent, 0o755), (folder, 0o755), (folder / "note.json", 0o644)):
            path.chmod(rights)

        def look_in_vain() -> None:
            assert runs_here() == []

        as_user(BOB, (GROUP,), look_in_vain)
        assert [run.user for run in runs_here()] == [str(MALLORY)]


@as_root
def test_a_directory_of_another_member_is_not_used(shared, group):
    """Bob has created the directory of Alice and given it to the group."""
    owned(shared / f"lfield-{ALICE}", BOB, 0o750, GROUP)

    def begin() -> None:
        with pytest.raises(OutputFileError, match="belongs to another user"):
            runs._create(NOTE, lambda text: None)

    as_user(ALICE, (GROUP,), begin)

    def look() -> None:
        assert runs_here() == []

    as_user(BOB, (GROUP,), look)
