"""`lfield keys page`: the keys of a page on a network, and the root that browsers must trust."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.authority.web_ca.web_keys import read_web_keys


@pytest.fixture
def authority(here, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("LFIELD_KEYS", "LFIELD_AUTHORITY"):
        monkeypatch.delenv(name, raising=False)
    here("keys", "init", "authority", status=0)
    monkeypatch.setenv("LFIELD_AUTHORITY", str(Path("authority").absolute()))
    return Path("authority").absolute()


def test_page_keys_are_created_with_a_root_that_is_created_once(here, authority: Path) -> None:
    result = here("keys", "page", "192.168.1.20", "Ground.local", "192.168.1.20")
    page = authority / "pages" / "192.168.1.20"
    assert (result.status, result.err) == (0, [])
    assert result.out[0].startswith("page 192.168.1.20, ground.local: until 20")
    assert result.out[1].strip().startswith(f"lfield watch --listen 192.168.1.20 --page-keys {page} ")
    assert f"import {authority}/browsers.crt as an authority" in result.out[2]
    assert "install that file as a CA certificate" in result.out[3]
    assert read_web_keys(page).names == ("192.168.1.20", "ground.local")
    root, keys = (authority / "browsers.crt").read_bytes(), read_web_keys(page)
    assert {
        (authority / "browsers.key").stat().st_mode & 0o777,
        (page / "page.key").stat().st_mode & 0o777,
    } == {0o600}
    # A second call makes a new certificate of the same root.
    here("keys", "page", "192.168.1.20", "--days", "30", status=0)
    assert (authority / "browsers.crt").read_bytes() == root
    assert read_web_keys(page).certificate != keys.certificate
    assert 29 * 86400 < read_web_keys(page).valid_until - keys.valid_from < 31 * 86400


def test_keys_of_a_page_are_shown_with_their_problems(here, authority: Path) -> None:
    here("keys", "page", "192.168.1.20", "ground.local", "--days", "200")
    page = authority / "pages" / "192.168.1.20"
    output = here("keys", "show", page)
    assert (output.status, len(output.out)) == (0, 1)
    assert output.out[0].startswith(f"keys {page}: a page at 192.168.1.20, ground.local, valid until 20")
    here("keys", "page", "192.168.1.20", "ground.local", "--days", "9")
    soon = here("keys", "show", page)
    assert ", expire in 8 days, 20" in soon.out[0]
    assert "'lfield keys page 192.168.1.20 ground.local' makes the next" in soon.out[1]
    (page / "page.key").chmod(0o644)
    result = here("keys", "show", page, status=69)
    assert f"run 'chmod 600 {page}/page.key'" in result.out[0]


@pytest.mark.parametrize(
    ("line", "status", "words"),
    [
        ("keys page", 64, "ADDRESS"),
        ("keys page 0.0.0.0", 65, "'0.0.0.0' is not an address or name for browsers"),
        ("keys page 10.0.0.1 8.8.8.8", 65, "8.8.8.8 is in no private network"),
        ("keys page ground.example", 65, "(names end in .local, .home.arpa, .internal, .lan)"),
        ("keys page 10.0.0.1 --days 399", 64, "must be a whole number of days from 1 to 398, not '399'"),
        ("keys page 10.0.0.1 --authority elsewhere", 65, "elsewhere has no authority"),
    ],
)
def test_an_invalid_page_is_refused_and_nothing_is_created(
    here, authority: Path, line: str, status: int, words: str
) -> None:
    before = sorted(authority.rglob("*"))
    result = here(*line.split(), status=status)
    assert words in result.err[0]
    assert sorted(authority.rglob("*")) == before


def test_a_mismatched_root_is_refused(here, authority: Path) -> None:
    here("keys", "page", "10.0.0.1")
    (authority / "browsers.key").unlink()
    assert "browsers.key is not there" in here("keys", "page", "10.0.0.1").err[0]
    (authority / "browsers.key").write_bytes((authority / "authority.key").read_bytes())
    (authority / "browsers.key").chmod(0o600)
    assert "put back browsers.crt and browsers.key of one copy" in here("keys", "page", "10.0.0.1").err[0]
