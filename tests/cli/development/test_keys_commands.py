"""`lfield keys` and `lfield sign`: a team's keys from the authority to the signature of a bundle."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lfield.authority import keystore as folders
from lfield.authority.bundle_signature import verify_bundle
from lfield.authority.certificate_reader import revoked_in, verify_keys
from lfield.authority.identity import Identity, Right
from lfield.authority.peer_verification import ALLOWED
from lfield.authority.rights import missing_permission
from lfield.mission import bundle
from lfield.wire.observer_messages import EmergencyStop

PROGRAM = "resource Bell { init(string[] arg) { } portal ring() { } }\n"
DEPLOYMENT = "//Bell:bell@alpha\n//Bell:other@bravo\n"


@pytest.fixture(autouse=True)
def own_settings(lfield, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of this test user's keys."""
    monkeypatch.setenv("XDG_CONFIG_HOME", f"{lfield.folder}/config")
    for name in ("LFIELD_KEYS", "LFIELD_AUTHORITY"):
        monkeypatch.delenv(name, raising=False)
    return lfield.folder / "config" / "lfield"


@pytest.fixture
def team(here, own_settings: Path) -> Path:
    """An authority with keys of two hosts and of anna, who has all rights and runs the test."""
    here("keys", "init", status=0)
    here("keys", "host", "alpha", "bravo", status=0)
    here("keys", "person", "anna", "--may", "operate,command", status=0)
    shutil.copytree(own_settings / "authority" / "people" / "anna", own_settings / "keys" / "me")
    return own_settings / "authority"


def test_created_keys_are_reported_with_their_destination(here, own_settings: Path) -> None:
    result = here("keys", "init", "--days", "30")
    assert re.fullmatch(
        rf"{own_settings}/authority: the authority [0-9a-f]{{12}}, until \S+ \S+ UTC", result.out[0]
    )
    assert "authority.key can issue keys with every right" in result.out[1]
    output = here("keys", "host", "alpha", "--days", "5")
    assert output.out[0].startswith("host alpha: until 20")
    assert f"~/.config/lfield/keys/alpha   a copy of {own_settings}/authority/hosts/alpha" in output.out[1]
    assert "/etc/lfield/keys/alpha, owned by the service's user" in output.out[2]
    anna = here("keys", "person", "anna", "--may", "stop")
    assert anna.out[0].endswith("may observe,stop")
    assert f"~/.config/lfield/keys/me, a copy of {own_settings}/authority/people/anna" in anna.out[1]


def test_one_command_creates_an_authority_and_the_keys_of_its_operator(here, own_settings: Path) -> None:
    here("keys", "init", "--person", "../x", status=65)
    assert not own_settings.exists()
    here("keys", "init", "--person", "anna", status=0)
    me = own_settings / "keys" / "me"
    found = verify_keys(folders.read_keys(me, "person"))
    assert (found.name, found.may) == ("anna", {Right.OBSERVE, Right.STOP, Right.OPERATE, Right.COMMAND})
    before = (me / "person.key").read_bytes()
    here("keys", "init", "other", "--person", "bob", status=65)
    assert not Path("other").exists()
    assert (me / "person.key").read_bytes() == before


def test_keys_of_a_team_are_listed_renewed_and_revoked(here, team: Path) -> None:
    here("keys", "renew", "host", "alpha", "--days", "700", status=0)
    revocation = here("keys", "revoke", "host", "bravo")
    assert re.fullmatch(r"host bravo: certificate [0-9a-f]{12} is revoked", revocation.out[0])
    assert re.fullmatch(rf"list \d{{10}} is {team}/revoked.crl: copy it .*", revocation.out[1])
    listed = [line.split() for line in here("keys", "list").out[1:]]
    assert [(fields[0], " ".join(fields[6:])) for fields in listed[1:]] == [
        ("good", "host alpha"),
        ("good", "host alpha"),
        ("revoked", "host bravo"),
        ("good", "anna, may observe,stop,operate,command"),
    ]
    assert " ".join(listed[0]).endswith("with 1 certificate")
    keys = folders.read_keys(team / "hosts" / "bravo", "host")
    assert verify_keys(keys).serial in revoked_in(keys.revoked, keys.authority).serials
    serial = listed[1][1]
    here("keys", "revoke", "serial", serial, status=0)
    assert here("keys", "renew", "authority").out[1].strip().startswith("nothing has to be copied")


def test_keys_of_a_folder_are_shown_with_their_problems(here, team: Path, own_settings: Path) -> None:
    output = here("keys", "show")
    assert (output.status, output.out[0].split(": ")[1][:11]) == (0, "anna, valid")
    alpha = team / "hosts" / "alpha"
    here("keys", "show", alpha, status=0)
    (alpha / "host.key").chmod(0o644)
    result = here("keys", "show", alpha, status=69)
    assert f"run 'chmod 600 {alpha}/host.key'" in result.out[0]
    here("keys", "revoke", "host", "bravo")
    assert "host bravo, revoked" in here("keys", "show", team / "hosts" / "bravo").out[0]
    here("keys", "person", "bob", "--may", "observe", "--days", "20")
    soon = here("keys", "show", team / "people" / "bob")
    assert (soon.status, soon.out[0].split(", ")[1]) == (0, "expire in 19 days")
    shutil.rmtree(own_settings / "keys")
    assert "no keys on this computer" in here("keys", "show").err[0]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("line", "status", "words"),
    [
        ("keys person bob --may fly", 64, "--may fly: rights are observe, stop, operate and command"),
        ("keys person bob --may stopp", 64, "stop"),
        ("keys person bob", 64, "--may"),
        ("keys person bob --may ,", 64, "--may names no right: rights are observe,"),
        ("keys host carl --days 0", 64, "must be a whole number of days from 1 to 36500, not '0'"),
        ("keys host carl --days soon", 64, "must be a whole number of days from 1 to 36500, not 'soon'"),
        ("keys host carl --days 0.5", 64, "must be a whole number of days from 1 to 36500, not '0.5'"),
        ("keys host carl --days nan", 64, "must be a whole number of days from 1 to 36500, not 'nan'"),
        ("keys host alpha", 65, "'lfield keys renew host alpha' makes them last longer"),
        ("keys host ../x", 65, "is not a valid name"),
        ("keys person anna --may stop", 65, "revoke person anna' ends them, and then there can be some"),
        ("keys renew person bob", 65, "'lfield keys person bob --may ...' makes some"),
        ("keys renew host", 64, "name the keys to renew"),
        ("keys renew authority alpha", 64, "name the keys to renew"),
        ("keys renew host carl", 65, "host carl has no keys that are not revoked"),
        ("keys revoke host carl", 65, "host carl has no keys of this authority"),
        ("keys revoke serial zz", 65, "is not the number of a certificate"),
        ("keys init", 65, "has an authority already"),
        ("keys list --authority elsewhere", 65, "elsewhere has no authority"),
        ("sign mission.dL", 64, "is not a bundle"),
        ("sign mission.lfm --keys none", 65, "none has no keys of a person"),
    ],
)
def test_invalid_command_lines_of_keys_and_sign_are_refused(
    here, lfield, team: Path, line: str, status: int, words: str
) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL")
    result = here(*line.split(), status=status)
    assert words in result.err[0]


@pytest.mark.parametrize("arguments", ["observe, stop", "stop,", " observe ,stop , "])
def test_rights_may_have_blanks_and_a_comma_at_the_end(here, team: Path, arguments: str) -> None:
    assert here("keys", "person", "bob", "--may", arguments).out[0].endswith("may observe,stop")


def test_the_hint_for_a_missing_right_grants_it(here, team: Path) -> None:
    may = frozenset({Right.OBSERVE, Right.COMMAND})
    here("keys", "person", "oli", "--may", "observe,command", status=0)
    refusal = missing_permission(Identity("person", "oli", may), ALLOWED, EmergencyStop(bytes(16), "fog"))
    for line in re.findall("'lfield (.*?)'", refusal):
        done = here(*line.split(), status=0)
    assert done.out[0].endswith("may observe,stop,command")


def test_an_authority_may_be_in_another_folder(here, lfield, monkeypatch: pytest.MonkeyPatch) -> None:
    here("keys", "init", "stick", status=0)
    here("keys", "host", "alpha", "--authority", "stick", status=0)
    monkeypatch.setenv("LFIELD_AUTHORITY", "stick")
    assert "host alpha" in here("keys", "list").out[1]


def test_a_bundle_is_signed_in_place_and_keeps_its_digest(
    here, lfield, team: Path, own_settings: Path
) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL", status=0)
    assert here("inspect", "mission.lfm").out[1] == "signed    no"
    path = lfield.folder / "mission.lfm"
    before = bundle.contents(path.read_bytes())
    result = here("sign", "mission.lfm")
    assert result.err == [f"mission.lfm: bundle {before.digest.hex()[:16]}, signed by anna"]
    after = bundle.contents(path.read_bytes())
    assert (after.digest, after.parts) == (before.digest, before.parts)
    trusted = folders.read_trusted(team)
    assert verify_bundle(after.digest, after.signature, trusted).identity.name == "anna"
    assert re.fullmatch(r"signed    by anna, 20\S+ \S+ UTC", here("inspect", "mission.lfm").out[1])
    bundle.read(path)
    # A second signature leaves the bundle unchanged.
    here("sign", "mission.lfm", status=0)
    assert len(path.read_bytes()) == sum(row.size for row in after.table) + len(after.signature) + (
        path.read_bytes().index(bytes(after.parts["program"]))
    )
    shutil.rmtree(own_settings / "keys" / "me")
    assert "no keys on this computer" in here("inspect", "mission.lfm").out[1]
    assert "no keys of yours on this computer" in here("sign", "mission.lfm").err[0]


def test_a_person_without_the_command_right_cannot_sign(here, lfield, team: Path) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL")
    here("keys", "person", "bob", "--may", "operate")
    before = (lfield.folder / "mission.lfm").read_bytes()
    result = here("sign", "mission.lfm", "--keys", team / "people" / "bob")
    assert (result.status, "bob may not sign bundles" in result.err[0]) == (65, True)
    assert (lfield.folder / "mission.lfm").read_bytes() == before


@pytest.mark.process
def test_a_full_disk_leaves_the_bundle_unchanged(here, lfield, team: Path) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL")
    before = (lfield.folder / "mission.lfm").read_bytes()
    done = subprocess.run(
        ["sh", "-c", f"ulimit -f 0; exec {sys.executable} -m lfield sign mission.lfm"],
        cwd=lfield.folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 73, done.stderr
    assert "cannot write mission.lfm" in done.stderr
    assert (lfield.folder / "mission.lfm").read_bytes() == before
    assert sorted(path.name for path in lfield.folder.glob("tmp*")) == []
