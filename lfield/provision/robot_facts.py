"""The facts of a robot that determine its installation: two shell scripts and their parser.

Both scripts need POSIX sh and the coreutils alone, so they run before there is a Python. Each line of their
output is a key and its values, separated by tabs.
"""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from collections.abc import Iterable, Mapping

from msgspec import Struct, field

#: The folder of lfield on a robot: an environment for each version, and the link to the active one.
ROOT = "/opt/lfield"
WHEELS, CURRENT = f"{ROOT}/wheels", f"{ROOT}/current"
#: The file that marks a complete environment; its contents have no meaning.
COMPLETE = ".complete"
#: The digest of the configuration with which the service was last started.
STARTED = f"{ROOT}/started"
UNIT = "/etc/systemd/system/lfield.service"
SETTINGS = "/etc/lfield"
KEYS = f"{SETTINGS}/keys"
#: The user of the service, and its group, whose members may observe and stop hosts.
SERVICE_USER = "lfield"

#: Run as the user of ssh: the user's name, and whether the user may become root without a password.
ACCESS_SCRIPT = r"""
printf 'user\t%s\t%s\n' "$(id -un)" "$(id -u)"
if [ "$(id -u)" = 0 ]; then printf 'sudo\tyes\n'
elif ! command -v sudo >/dev/null; then printf 'sudo\tmissing\n'
elif sudo -n sh -c true 2>/dev/null; then printf 'sudo\tyes\n'
elif sudo -n sh -c true 2>&1 | grep -q 'have a tty'; then printf 'sudo\ttty\n'
else printf 'sudo\tpassword\n'; fi
"""

#: Run as root. `{user}` is the user of ssh, `{groups}` and `{keys}` are those that the inventory names.
_FACTS_SCRIPT = r"""
value() { printf '%s\t%s\n' "$1" "$2"; }
value time "$(date +%s)"
value machine "$(uname -m)"
value bits "$(getconf LONG_BIT 2>/dev/null)"
value glibc "$(getconf GNU_LIBC_VERSION 2>/dev/null | cut -d' ' -f2)"
value system "$(. /etc/os-release 2>/dev/null; printf %s "$PRETTY_NAME")"
[ -d /run/systemd/system ] && value systemd yes
for name in python3 python3.13 python3.12 python3.11; do
  found=$(PATH=/usr/local/bin:/usr/bin:/bin command -v $name) || continue
  printf 'python\t%s\t%s\n' "$found" "$("$found" -I -c '
import sys
try: import venv, ssl, zlib; usable = "yes"
except ImportError: usable = "no"
print("%d.%d.%d" % sys.version_info[:3], usable, sep="\t")' 2>/dev/null)"
done
for folder in /opt/lfield/python/*/; do
  [ -e "$folder/.complete" ] && value standalone "$(basename "$folder")"
done
df -Pk /opt 2>/dev/null | awk 'NR == 2 {printf "free\t%s\n", $4}'
value existing "$(getent group {groups} | cut -d: -f1 | tr '\n' ' ')"
if id lfield >/dev/null 2>&1; then value service "$(id -nG lfield)"; fi
value member "$(id -nG {user})"
for folder in /opt/lfield/*/; do
  [ -e "$folder/.complete" ] && value version "$(basename "$folder")"
done
if [ -L /opt/lfield/current ]; then value current "$(basename "$(readlink /opt/lfield/current)")"; fi
value started "$(cat /opt/lfield/started 2>/dev/null)"
digest() { [ -f "$1" ] && printf '%s\t%s\t%s\n' "$2" "$1" "$(sha256sum <"$1" | cut -d' ' -f1)"; }
for file in /opt/lfield/wheels/*.whl; do digest "$file" wheel; done
for file in /etc/systemd/system/lfield.service /etc/lfield/* /etc/lfield/keys/{keys}/*; do
  [ -f "$file" ] || continue
  digest "$file" file
  printf 'mode\t%s\t%s\n' "$file" "$(stat -c '%a:%U:%G' "$file")"
done
name=$(sed -n 's/^LFIELD_HOST=//p' /etc/lfield/service.env 2>/dev/null)
[ -n "$name" ] && [ -d "/etc/lfield/keys/$name" ] && value host "$name"
[ "$(stat -c '%a:%U:%G' /etc/lfield/keys/{keys} 2>/dev/null)" = 700:lfield:lfield ] && value keys private
if command -v systemctl >/dev/null; then
  value enabled "$(systemctl is-enabled lfield.service 2>/dev/null)"
  value active "$(systemctl is-active lfield.service 2>/dev/null)"
fi
true
"""

#: Names of architectures by `uname -m` and vendors, with the names in wheels.
_ARCHITECTURES = {"arm64": "aarch64", "amd64": "x86_64", "armv8l": "armv7l"}


class LoginAccess(Struct, frozen=True):
    """The user of ssh on a robot; `sudo` is yes, missing, password, or tty (it requires a terminal)."""

    user: str
    uid: int
    sudo: str


class RobotPython(Struct, frozen=True):
    """A Python of a robot: its path, its version, and whether it can make environments."""

    path: str
    version: tuple[int, int, int]
    is_usable: bool

    @property
    def tag(self) -> str:
        """The version as in the inventory: 3.11."""
        return f"{self.version[0]}.{self.version[1]}"


class RobotFacts(Struct, frozen=True):
    """The state of a robot; `free` is in bytes, `time` in seconds since 1970, digests are SHA-256 in hex."""

    time: float
    arch: str
    glibc: tuple[int, ...]
    system: str
    has_systemd: bool
    pythons: tuple[RobotPython, ...]
    #: The versions of standalone Pythons that provision has brought.
    standalone: frozenset[str]
    free: int
    existing_groups: frozenset[str]
    #: Groups of the service's user, None without such a user; and those of the user of ssh.
    service_groups: frozenset[str] | None
    member_of: frozenset[str]
    #: Complete environments, the active one, and the digest of the configuration of the last start.
    versions: frozenset[str]
    current: str
    started: str
    #: Digest of each wheel and settings file by its path; mode, owner and group as 640:root:lfield.
    wheels: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    modes: Mapping[str, str] = field(default_factory=dict)
    has_private_keys_folder: bool = False
    is_enabled: bool = False
    is_active: bool = False
    #: The host whose keys the robot has and as which its service runs; '' for none.
    host: str = ""


def facts_script(user: str, groups: Iterable[str], host: str) -> str:
    """The script that reports the facts; `user` is that of ssh, `groups` and `host` are of the inventory."""
    named = " ".join(map(shlex.quote, sorted(set(groups)))) or "dialout"
    values = {"{user}": shlex.quote(user), "{groups}": named, "{keys}": shlex.quote(host)}
    return re.sub("|".join(map(re.escape, values)), lambda found: values[found[0]], _FACTS_SCRIPT)


def parse_access(output: str) -> LoginAccess:
    """The access in the output of ACCESS_SCRIPT. Raises ValueError for any other text."""
    rows = _rows(output)
    if not rows["user"] or not rows["sudo"]:
        raise ValueError(output.strip() or "no output")
    user, uid = rows["user"][-1]
    return LoginAccess(user, int(uid), rows["sudo"][-1][0])


def parse_facts(output: str) -> RobotFacts:
    """The facts in the output of `facts_script`. Raises ValueError for any other text."""
    rows = _rows(output)
    if not rows["time"] or not rows["machine"]:
        raise ValueError(output.strip() or "no output")

    def value(key: str) -> str:
        return rows[key][-1][0] if rows[key] and rows[key][-1] else ""

    def named(key: str) -> frozenset[str]:
        return frozenset(row[0] for row in rows[key] if row and row[0])

    pythons = [_python(row) for row in rows["python"] if len(row) == 3]
    return RobotFacts(
        time=float(value("time")),
        arch=_architecture(value("machine"), value("bits")),
        glibc=tuple(int(part) for part in value("glibc").split(".") if part.isdecimal()),
        system=value("system"),
        has_systemd=value("systemd") == "yes",
        pythons=tuple({python.path: python for python in pythons}.values()),
        standalone=named("standalone"),
        free=int(value("free") or 0) * 1024,
        existing_groups=frozenset(value("existing").split()),
        service_groups=frozenset(value("service").split()) if rows["service"] else None,
        member_of=frozenset(value("member").split()),
        versions=named("version"),
        current=value("current"),
        started=value("started"),
        wheels={row[0].rpartition("/")[2]: row[1] for row in rows["wheel"] if len(row) == 2},
        files={row[0]: row[1] for row in rows["file"] if len(row) == 2},
        modes={row[0]: row[1] for row in rows["mode"] if len(row) == 2},
        has_private_keys_folder=value("keys") == "private",
        is_enabled=value("enabled") == "enabled",
        is_active=value("active") == "active",
        host=value("host"),
    )


def _rows(output: str) -> dict[str, list[list[str]]]:
    found: dict[str, list[list[str]]] = defaultdict(list)
    for line in output.splitlines():
        key, *values = line.split("\t")
        if values:
            found[key].append(values)
    return found


def _python(row: list[str]) -> RobotPython:
    major, minor, patch = map(int, row[1].split("."))
    return RobotPython(row[0], (major, minor, patch), row[2] == "yes")


def _architecture(machine: str, bits: str) -> str:
    """The architecture of the programs: a 64-bit kernel may run a system of 32 bits (Raspberry Pi OS)."""
    arch = _ARCHITECTURES.get(machine, machine)
    return "armv7l" if arch == "aarch64" and bits == "32" else arch
