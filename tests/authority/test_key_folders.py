"""Key folders, and the folder of an authority: contents, permissions, refusals."""

from __future__ import annotations

import os
import re
import shutil
import stat
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfield.authority import keystore as folders
from lfield.authority.certificate_reader import revoked_in, verify_keys
from lfield.authority.identity import Identity, Right
from lfield.authority.key_material import Keys
from lfield.authority.ledger import Ledger, create_ledger, open_ledger
from lfield.errors import KeysError, NoHomeFolder, OutputFileError
from lfield.operator.key_health import health
from lfield.text.user_dirs import config_dir

AT, DAY = 1795464000.0, 86400.0


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    return create_ledger(tmp_path / "authority", AT, AT + 3650 * DAY)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def check_refused(folder: Path, words: str, holder="host") -> None:
    with pytest.raises(KeysError, match=words):
        folders.read_keys(folder, holder)


def test_user_without_home_has_no_own_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "")
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 54321)
    assert folders.find_keys("host", "alpha", None, {}, tmp_path) is None
    assert folders.local_folders({}, tmp_path) == []
    with pytest.raises(NoHomeFolder, match="set HOME, or XDG_CONFIG_HOME"):
        config_dir()


def test_keys_are_read_back_and_the_private_key_is_protected(ledger: Ledger) -> None:
    before = os.umask(0)
    try:
        keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    finally:
        os.umask(before)
    keys = folders.read_keys(keys_folder.folder, "host")
    assert verify_keys(keys) == keys_folder.identity
    assert {path.name: mode(path) for path in keys_folder.folder.iterdir()} == {
        "authority.pem": 0o644,
        "host.pem": 0o644,
        "host.key": 0o600,
        "revoked.crl": 0o644,
    }
    assert mode(keys_folder.folder) == mode(keys_folder.folder.parent) == mode(ledger.folder) == 0o700
    assert mode(ledger.folder / "issued") == 0o700
    assert mode(ledger.folder / "authority.key") == 0o600


@pytest.mark.parametrize("bits", [0o640, 0o604, 0o610, 0o601])
def test_private_key_readable_by_others_is_refused(ledger: Ledger, bits: int) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    key = keys_folder.folder / "host.key"
    key.chmod(bits)
    check_refused(keys_folder.folder, f"it is secret, and others may read it: run 'chmod 600 {key}'")
    key.chmod(0o400)
    folders.read_keys(keys_folder.folder, "host")


def test_key_files_writable_by_others_are_refused(ledger: Ledger) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    (keys_folder.folder / "authority.pem").chmod(0o664)
    check_refused(keys_folder.folder, r"authority.pem cannot be used: others may write to it")
    (keys_folder.folder / "authority.pem").chmod(0o644)
    keys_folder.folder.chmod(0o770)
    check_refused(keys_folder.folder, "others may write to the folder")


def test_missing_linked_or_too_large_key_files_are_refused(ledger: Ledger, tmp_path: Path) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    key = keys_folder.folder / "host.key"
    key.rename(tmp_path / "elsewhere")
    check_refused(keys_folder.folder, r"host.key is not there: copy the folder again")
    key.symlink_to(tmp_path / "elsewhere")
    check_refused(keys_folder.folder, "it is a link; copy the file itself")
    key.unlink()
    os.mkfifo(key, 0o600)
    check_refused(keys_folder.folder, "not a plain file")
    key.unlink()
    folders.write_keys(keys_folder.folder, Keys("host", b"a", b"c", b"k" * (17 << 10)))
    check_refused(keys_folder.folder, "too large")


def test_link_to_a_key_folder_is_followed_and_checked(ledger: Ledger, tmp_path: Path) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    link = tmp_path / "link"
    link.symlink_to(keys_folder.folder)
    assert folders.read_keys(link, "host") == folders.read_keys(keys_folder.folder, "host")
    keys_folder.folder.chmod(0o770)
    check_refused(link, "others may write to the folder")


def test_host_keys_without_a_revocation_list_are_refused(ledger: Ledger) -> None:
    host, person = (
        ledger.make(kind, "alpha", (), AT, AT + DAY).folder
        for kind in ("host", "person")  # type: ignore[arg-type]
    )
    assert revoked_in(folders.read_crl(host), ledger.authority.certificate).serials == set()
    assert folders.read_keys(person, "person").revoked == b""
    (host / "revoked.crl").unlink()
    check_refused(host, r"revoked.crl is not there: copy the folder again")


@given(data=st.data())
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_truncated_copy_of_keys_is_refused(ledger: Ledger, data) -> None:
    folder, found_keys = _alpha_keys(ledger)
    path = data.draw(st.sampled_from(sorted(folder.iterdir())))
    content = path.read_bytes()
    length = data.draw(st.one_of(st.just(0), st.integers(0, len(content) - 1)))
    path.write_bytes(content[:length])
    try:
        found = verify_keys(folders.read_keys(folder, found_keys.kind))
    except KeysError:
        found = None
    (finding,) = health(folder, AT)
    path.write_bytes(content)
    # A PEM text is complete without the newline at its end.
    assert found == (found_keys if path.suffix != ".crl" and not content[length:].strip() else None)
    assert finding.state == ("problem" if found is None else "warning")


def _alpha_keys(ledger: Ledger) -> tuple[Path, Identity]:
    """The key folder and the identity of host alpha; the ledger also revoked host bravo."""
    if not ledger.rows(AT):
        ledger.make("host", "bravo", (), AT, AT + DAY)
        ledger.make("host", "alpha", (), AT, AT + DAY)
        ledger.revoke("host", "bravo", AT)
    return ledger.folder / "hosts" / "alpha", ledger.rows(AT)[0].identity


@pytest.mark.parametrize("holder", ["host", "person"])
def test_empty_revocation_list_is_refused(ledger: Ledger, holder) -> None:
    folder = ledger.make(holder, "alpha", (), AT, AT + DAY).folder
    (folder / "revoked.crl").write_bytes(b"")
    check_refused(folder, r"revoked.crl is empty: it was cut short when it was copied", holder)
    (ledger.folder / "revoked.crl").write_bytes(b"")
    with pytest.raises(KeysError, match="is empty"), open_ledger(ledger.folder):
        pass


@pytest.mark.parametrize("part", [0, 0.5])
def test_error_names_the_truncated_file_of_an_authority(ledger: Ledger, part: float) -> None:
    ledger.make("host", "alpha", (), AT, AT + DAY)
    for path in (*ledger.folder.glob("issued/*"), *ledger.folder.glob("*.*")):
        named = path if part == 0 or path.stem != "authority" else ledger.folder
        content = path.read_bytes()
        path.write_bytes(content[: int(part * len(content))])
        with pytest.raises(KeysError, match=re.escape(f"{named}")), open_ledger(ledger.folder) as again:
            again.rows(AT)
        path.write_bytes(content)


def test_authority_without_its_revocation_list_is_refused(ledger: Ledger) -> None:
    ledger.make("host", "alpha", (), AT, AT + DAY)
    revoked = ledger.revoke("host", "alpha", AT)
    backup = (ledger.folder / "revoked.crl").rename(ledger.folder / "kept")
    with (
        pytest.raises(KeysError, match="copy it there from the keys of any host"),
        open_ledger(ledger.folder),
    ):
        pass
    backup.rename(ledger.folder / "revoked.crl")
    with open_ledger(ledger.folder) as again:
        assert again.revoked.serials == {keys.serial for keys in revoked}


def test_key_folders_are_searched_in_order(
    ledger: Ledger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alpha = ledger.make("host", "alpha", (), AT, AT + DAY).folder
    anna = ledger.make("person", "anna", [Right.STOP], AT, AT + DAY).folder
    home, system = tmp_path / "home", tmp_path / "system"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home))

    def found(holder, name, named=None, **more) -> Path | None:
        return folders.find_keys(holder, name, named, more, system)

    assert found("host", "alpha") is found("person", folders.OWN) is None
    own = home / "lfield" / "keys"
    own.mkdir(parents=True)
    (own / "alpha").symlink_to(alpha)
    (own / "me").symlink_to(anna)
    assert found("host", "alpha") == own / "alpha"
    assert found("person", "me") == own / "me"
    assert found("host", "me") is None
    system.mkdir()
    (system / "alpha").symlink_to(alpha)
    assert found("host", "alpha") == system / "alpha"
    assert folders.local_folders({}, system) == [system / "alpha", own / "alpha", own / "me"]
    assert found("host", "alpha", LFIELD_KEYS=str(alpha)) == alpha
    assert found("host", "alpha", LFIELD_KEYS=str(alpha.parent)) == alpha
    assert found("host", "alpha", alpha, LFIELD_KEYS="/nowhere") == alpha
    for named in (anna, tmp_path, tmp_path / "nowhere"):
        with pytest.raises(KeysError, match=f"{named} has no keys of host alpha"):
            found("host", "alpha", named)
    with pytest.raises(KeysError, match="/nowhere has no keys of a person"):
        found("person", "me", LFIELD_KEYS="/nowhere")


def test_host_name_cannot_refer_to_a_parent_of_the_key_folder(
    ledger: Ledger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    alpha = ledger.make("host", "alpha", (), AT, AT + DAY).folder
    below = alpha / "keys"
    below.mkdir()
    assert folders.find_keys("host", "..", None, {}, below) is None


# --- the authority's ledger --------------------------------------------------------------------------------


def states(ledger: Ledger, at: float = AT) -> list[tuple[str, str]]:
    return [(str(row.identity), row.state) for row in ledger.rows(at)]


def test_authority_is_created_once(ledger: Ledger) -> None:
    with pytest.raises(KeysError, match="has an authority already"):
        create_ledger(ledger.folder, AT, AT + DAY)
    with open_ledger(ledger.folder) as again:
        assert again.authority.fingerprint == ledger.authority.fingerprint
    with (
        pytest.raises(KeysError, match="has no authority: 'lfield keys init' makes one"),
        open_ledger(ledger.folder / "x"),
    ):
        pass


def test_authority_key_readable_by_others_is_refused(ledger: Ledger) -> None:
    (ledger.folder / "authority.key").chmod(0o644)
    with pytest.raises(KeysError, match="it is secret"), open_ledger(ledger.folder):
        pass
    ledger.folder.chmod(0o777)
    with pytest.raises(OutputFileError, match="others may write"), open_ledger(ledger.folder):
        pass


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "-x", ".alpha", "a b", "al\npha", "ä", "[::1", "x" * 129]
)
def test_invalid_name_is_refused(ledger: Ledger, name: str) -> None:
    with pytest.raises(KeysError, match="is not a valid name"):
        ledger.make("host", name, (), AT, AT + DAY)
    assert not (ledger.folder / "issued").exists()


def test_host_name_may_be_an_address(ledger: Ledger) -> None:
    for name in ("10.42.0.11", "[fd00::1]", "rover-7.local"):
        assert (
            verify_keys(folders.read_keys(ledger.make("host", name, (), AT, AT + DAY).folder, "host")).name
            == name
        )


def test_existing_keys_are_renewed_not_created_again(ledger: Ledger) -> None:
    old = ledger.make("person", "anna", [Right.STOP], AT, AT + DAY)
    before = folders.read_keys(old.folder, "person")
    with pytest.raises(KeysError, match="'lfield keys renew person anna' makes them last longer"):
        ledger.make("person", "anna", [Right.STOP], AT, AT + DAY)
    new = ledger.renew("person", "anna", AT + 1, AT + 9 * DAY)
    assert (new.identity.may, new.identity.valid_until) == ({Right.STOP, Right.OBSERVE}, AT + 9 * DAY)
    assert folders.read_keys(new.folder, "person").key == before.key
    assert states(ledger) == [("anna", "good"), ("anna", "good")]
    assert states(ledger, AT + 2 * DAY) == [("anna", "ended"), ("anna", "good")]
    other = ledger.renew("person", "anna", AT + 2, AT + 9 * DAY, new_key=True)
    keys = folders.read_keys(other.folder, "person")
    assert keys.key != before.key
    assert verify_keys(keys) == other.identity


def test_keys_are_renewed_without_a_stored_private_key(ledger: Ledger) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    (keys_folder.folder / "host.key").unlink()
    ledger.renew("host", "alpha", AT + 1, AT + 9 * DAY)
    assert not (keys_folder.folder / "host.key").exists()


def test_expired_keys_can_be_created_again(ledger: Ledger) -> None:
    ledger.make("host", "alpha", (), AT, AT + DAY)
    ledger.make("host", "alpha", (), AT + DAY, AT + 2 * DAY)
    assert states(ledger, AT + DAY) == [("host alpha", "ended"), ("host alpha", "good")]


def test_revocation_covers_all_keys_and_updates_every_folder(ledger: Ledger) -> None:
    alpha = ledger.make("host", "alpha", (), AT, AT + DAY)
    ledger.renew("host", "alpha", AT + 1, AT + 9 * DAY)
    bravo = ledger.make("host", "bravo", (), AT, AT + DAY)
    revoked = ledger.revoke("host", "alpha", AT + 2)
    assert len(revoked) == 2
    assert states(ledger) == [("host alpha", "revoked"), ("host alpha", "revoked"), ("host bravo", "good")]
    for folder in (ledger.folder, alpha.folder, bravo.folder):
        found = revoked_in(folders.read_crl(folder), ledger.authority.certificate)
        assert (found.number, found.serials) == (int(AT) + 2, {keys.serial for keys in revoked})
    with pytest.raises(KeysError, match="no keys of this authority that are not revoked"):
        ledger.revoke("host", "alpha", AT + 2)
    with pytest.raises(KeysError, match="no keys that are not revoked: 'lfield keys host alpha' makes some"):
        ledger.renew("host", "alpha", AT + 3, AT + DAY)
    remade = ledger.make("host", "alpha", (), AT + 3, AT + DAY)
    assert folders.read_keys(remade.folder, "host").revoked == folders.read_crl(ledger.folder)
    with open_ledger(ledger.folder) as again:
        again.revoke("host", "bravo", AT + 4)
        assert (again.revoked.number, len(again.revoked.serials)) == (int(AT) + 4, 3)


def test_one_certificate_is_revoked_by_its_serial_number(ledger: Ledger) -> None:
    old = ledger.make("host", "alpha", (), AT, AT + DAY).identity
    new = ledger.renew("host", "alpha", AT + 1, AT + 9 * DAY).identity
    assert ledger.revoke_serial(new.serial, AT + 2) == [new]
    assert ledger.rows(AT)[0] == (old, "good")
    assert ledger.renew("host", "alpha", AT + 3, AT + 9 * DAY).identity.serial not in (old.serial, new.serial)
    for serial, text in (
        (new.serial, "is revoked already"),
        ("x", "is not the number"),
        ("abcdef0", "no cert"),
    ):
        with pytest.raises(KeysError, match=text):
            ledger.revoke_serial(serial, AT + 3)


def test_list_numbers_increase_after_restoring_a_backup(ledger: Ledger, tmp_path: Path) -> None:
    anna, bob = (ledger.make("person", name, (), AT, AT + DAY).identity for name in ("anna", "bob"))
    copy = shutil.copytree(ledger.folder, tmp_path / "copy")
    ledger.revoke("person", "anna", AT + 2)
    ledger.revoke_serial(bob.serial, AT + 2)
    assert ledger.revoked.number == int(AT) + 3, "two lists of the same second have different numbers"
    with open_ledger(copy) as back:
        back.revoke("person", "bob", AT + 60)
        assert back.revoked.number > ledger.revoked.number
        # A certificate missing in the backup is revoked by its full number, which the hosts report.
        assert back.revoke_serial(anna.serial, AT + 61)[0].serial == anna.serial
        assert back.revoked.serials == ledger.revoked.serials


def test_unknown_certificate_is_revoked_by_its_full_number(ledger: Ledger) -> None:
    serial = f"{1 << 158:x}"
    (made,) = ledger.revoke_serial(serial, AT)
    assert (str(made), ledger.revoked.serials) == ("an unauthenticated peer", {serial})
    with pytest.raises(KeysError, match="no certificates have a number that begins with"):
        ledger.revoke_serial(serial[:36], AT)
    with pytest.raises(KeysError, match="is revoked already"):
        ledger.revoke_serial(serial, AT)


def test_issued_keys_stay_valid_after_renewing_the_authority(ledger: Ledger) -> None:
    keys_folder = ledger.make("host", "alpha", (), AT, AT + DAY)
    ledger.renew_authority(AT + 1, AT + 9999 * DAY)
    assert verify_keys(folders.read_keys(keys_folder.folder, "host")) == keys_folder.identity
    assert ledger.make("host", "bravo", (), AT + 2, AT + 9000 * DAY).identity.valid_until == AT + 9000 * DAY


def test_ledger_refuses_changes_after_the_clock_was_set_back(ledger: Ledger) -> None:
    ledger.make("host", "alpha", (), AT + DAY, AT + 2 * DAY)
    for change in (
        lambda: ledger.make("host", "bravo", (), AT, AT + DAY),
        lambda: ledger.revoke("host", "alpha", AT),
        lambda: ledger.renew_authority(AT, AT + 9999 * DAY),
    ):
        with pytest.raises(KeysError, match="has issued keys 2026-11-24 20:00 UTC: set the clock"):
            change()
