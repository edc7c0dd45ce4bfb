"""Dumps of failed agents: in a private folder of the user, and not in a blocking file."""

from __future__ import annotations

import os
import stat

import pytest

pytestmark = pytest.mark.process

DIES = """
coordinator Careless { init(string[] arg) { print(i2s(1 / (arg.length() - 1))); } }
coordinator Careful { init(string[] arg) { sleep(1.0); print("goes on"); } }
"""
DEPLOYMENT = "//Careless:tom@alpha\n//Careful:ann@alpha\n"


@pytest.fixture
def run(lfield):
    """`run()`: run the mission to its end with `--dump dumps`."""

    def to_the_end():
        arguments = ("up", "--deploy", lfield.mission(DIES, DEPLOYMENT), "--host", "alpha", "--until-done")
        done = lfield(*arguments, *lfield.maps(["alpha"]), "--dump", "dumps", status=1)
        assert "ann: goes on" in done.err
        return done

    return to_the_end


@pytest.mark.few(0)
def test_a_dump_is_private_to_its_user(lfield, run):
    assert "tom dumped: read it with 'lfield inspect dumps/tom.block'" in run().err
    folder = lfield.folder / "dumps"
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, folder / "tom.block")] == [0o700, 0o600]
    assert [path.name for path in folder.iterdir()] == ["tom.block"]


@pytest.mark.few(0)
def test_a_dump_onto_a_fifo_is_refused_and_the_host_continues(lfield, run):
    dumps = lfield.folder / "dumps"
    dumps.mkdir(mode=0o700)
    os.mkfifo(dumps / "tom.block")
    path = "dumps/tom.block"
    refused = f"tom not dumped to {path}: cannot write {path}: it exists and is not a plain file; remove it"
    assert refused in run().err


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["fifo", "link", "open"])
def test_an_unusable_dump_folder_is_refused_before_the_start(lfield, here, kind):
    dumps, elsewhere = lfield.folder / "dumps", lfield.folder / "elsewhere"
    elsewhere.mkdir()
    if kind == "fifo":
        os.mkfifo(dumps)
        reason = "it is not a folder"
    elif kind == "link":
        dumps.symlink_to(elsewhere)
        reason = "it is a link; name its target instead"
    else:
        dumps.mkdir()
        dumps.chmod(0o777)
        reason = "others may write to the folder: run 'chmod go-w dumps', or name another"
    done = here("up", lfield.mission(DIES, DEPLOYMENT), "--all", "--until-done", "--dump", "dumps")
    assert (done.status, done.err) == (73, [f"lfield: cannot write dumps: {reason}"])
