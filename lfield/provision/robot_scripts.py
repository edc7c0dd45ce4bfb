"""The shell scripts that change a robot, each run as root. All of them may be interrupted and repeated.

Files arrive as an archive on stdin and are extracted into a temporary folder, which is the working directory
of the script. A file gets its final name by a rename, and an environment counts only with its mark.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence

from lfield.provision.installation import Installation, RobotFile
from lfield.provision.robot_facts import COMPLETE, CURRENT, KEYS, ROOT, SERVICE_USER, STARTED, WHEELS

#: Seconds that a command waits for that of an interrupted run or of another desk.
LOCK_TIMEOUT = 300
#: Exit status when that command does not end within this time.
BUSY = 75
#: The file that serialises commands on a robot.
_LOCK = "/run/lfield-provision.lock"
#: The archive of a standalone Python, and the requirements, as they arrive.
ARCHIVE, REQUIREMENTS = "python.tar.gz", "requirements.txt"

_HEAD = f"""
set -eu
umask 022
mkdir -p {ROOT}
rm -rf {ROOT}/.stage.*
stage=$(mktemp -d {ROOT}/.stage.XXXXXX)
trap 'rm -rf "$stage"' EXIT
cd "$stage"
tar -xf -
put() {{
  chown "$4" "$1"; chmod "$3" "$1"
  mv -f "$1" "$2.new"; mv -fT "$2.new" "$2"
}}
"""


def locked_command(script: str) -> str:
    """The command line that runs a script with its files, alone on the robot.

    The script does not inherit the lock: processes that it starts may outlive it.
    """
    return f"flock -o -w {LOCK_TIMEOUT} -E {BUSY} {_LOCK} sh -c {shlex.quote(_HEAD + script)}"


def python_script(version: str, sha256: str) -> str:
    """Install a standalone Python, once its archive is found intact."""
    folder = shlex.quote(f"{ROOT}/python/{version}")
    return f"""
if [ -e {folder}/{COMPLETE} ]; then exit 0; fi
echo '{sha256}  {ARCHIVE}' | sha256sum --check --quiet -
rm -rf {folder}; mkdir -p {folder}
tar -xzf {ARCHIVE} -C {folder} --no-same-owner
chmod -R go+rX {folder}
sync; touch {folder}/{COMPLETE}
"""


def users_script(user: str, groups: Iterable[str]) -> str:
    """Create the service's user, with its groups; the user of ssh joins its group."""
    named = shlex.quote(",".join(sorted(groups)))
    join = "" if user == "root" else f"usermod --append --groups {SERVICE_USER} {shlex.quote(user)}"
    return f"""
getent group {SERVICE_USER} >/dev/null || groupadd --system {SERVICE_USER}
id {SERVICE_USER} >/dev/null 2>&1 || useradd --system --gid {SERVICE_USER} --no-create-home \\
  --home-dir /var/lib/{SERVICE_USER} --shell /usr/sbin/nologin {SERVICE_USER}
usermod --append --groups {named} {SERVICE_USER}
{join}
"""


def wheels_script(files: Sequence[tuple[str, str]]) -> str:
    """Move wheels to their folder if they have arrived intact: file name and SHA-256 of each."""
    checks = "\n".join(f"{sha256}  {name}" for name, sha256 in files)
    names = " ".join(shlex.quote(name) for name, _ in files)
    return f"""
sha256sum --check --quiet - <<'END'
{checks}
END
mkdir -p {WHEELS}
chown root:root {names}; chmod 644 {names}
mv -f {names} {WHEELS}/
"""


def environment_script(environment: str, python: str) -> str:
    """Make the environment from the wheels. pip runs from its wheel: a vendor's Python may have none."""
    folder = shlex.quote(f"{ROOT}/{environment}")
    return f"""
if [ -e {folder}/{COMPLETE} ]; then exit 0; fi
rm -rf {folder}
{shlex.quote(python)} -I -m venv --without-pip {folder}
{folder}/bin/python -I "$(echo {WHEELS}/pip-*.whl)/pip" --isolated --no-cache-dir \\
  --disable-pip-version-check install --quiet --root-user-action ignore \\
  --no-index --no-deps --find-links {WHEELS} --require-hashes -r {REQUIREMENTS}
{folder}/bin/lfield --version >/dev/null
cp {REQUIREMENTS} {folder}/
sync; touch {folder}/{COMPLETE}
"""


def files_script(files: Sequence[RobotFile]) -> str:
    """Install files, which arrive under their numbers. The service no longer runs with the installed
    files.
    """
    folders = sorted({file.path.rpartition("/")[0] for file in files})
    folder_commands = [
        f"[ -d {shlex.quote(folder)} ] || install -d -m 755 {shlex.quote(folder)}" for folder in folders
    ]
    file_commands = [
        f"put {number} {shlex.quote(file.path)} {file.mode} {file.owner}" for number, file in enumerate(files)
    ]
    return "\n".join(["", f"rm -f {STARTED}", *folder_commands, *file_commands, ""])


def keys_script(folder: str, files: Sequence[RobotFile]) -> str:
    """Install keys into a folder that only the service's user can enter."""
    path = shlex.quote(f"{KEYS}/{folder}")
    return f"""
install -d -m 755 {KEYS}
install -d -m 700 -o {SERVICE_USER} -g {SERVICE_USER} {path}
{files_script(files)}
"""


def version_script(installation: Installation, wheels: Iterable[str], before: str) -> str:
    """Switch the link to the environment; remove others except the last one, and wheels of others."""
    environment = installation.payload.environment
    kept_folders = "|".join(shlex.quote(name) for name in {environment, before} if name)
    files = "|".join(shlex.quote(name) for name in sorted(wheels))
    return f"""
rm -f {STARTED}
ln -s {shlex.quote(environment)} current; mv -fT current {CURRENT}
cd {ROOT}
for folder in [0-9]*/; do case "${{folder%/}}" in {kept_folders}) ;; *) rm -rf "./$folder" ;; esac; done
cd {WHEELS}
for file in *.whl; do case "$file" in {files}) ;; *) rm -f "./$file" ;; esac; done
sync
"""


def service_script(configuration: str) -> str:
    """Start the service with the present installation, also at each boot."""
    return f"""
systemctl daemon-reload
systemctl enable --quiet lfield.service
systemctl restart lfield.service
echo {configuration} >started
put started {STARTED} 644 root:root
sync
"""
