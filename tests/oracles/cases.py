"""The cases of golden files by command and case name, each a sequence of command lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from command_lines import ROOT

Cases = Mapping[str, Mapping[str, Sequence[str]]]

#: All missions of the examples; those from 10 on are programs of the thesis.
MISSIONS = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob("examples/*/*.dL"))
SERVER = "examples/10-client-server/mission"
LIFT = "examples/02-equivalent-lift/mission"
#: Files with errors, and files of other formats.
_WRONG = "tests/lang/golden/deployments/errors"
_MISTAKES = (f"{_WRONG}/L701_shape.dL", f"{_WRONG}/L705_duplicate.dL", f"{_WRONG}/L712_empty.dL")
_PROGRAM_MISTAKES = "tests/lang/golden/errors/L202_member.L"
_REGISTRY_MISTAKES = "tests/oracles/mistakes.capabilities.yaml"


def _of_missions(*lines: str) -> dict[str, list[str]]:
    return {mission: [line.format(mission) for line in lines] for mission in MISSIONS}


CASES: Cases = {
    "check": {
        **_of_missions("check {0}", "check --json {0}"),
        **{file: [f"check {file}", f"check --json {file}"] for file in _MISTAKES},
        "no such file": ["check nowhere.dL", "check --json nowhere.dL"],
        "program": [f"check {_PROGRAM_MISTAKES}", f"check --json {_PROGRAM_MISTAKES}"],
        "no files": ["check"],
    },
    "new": {
        "a mission": [
            "new survey --into OUT/survey",
            "check OUT/survey/mission.dL",
            "new survey --into OUT/survey",
        ],
        "no name": ["new Survey", "new copter", "new"],
    },
    "fmt": {
        "formatted": [f"fmt --check {SERVER}.L {SERVER}.dL"],
        "mistakes": [f"fmt {_PROGRAM_MISTAKES} {_MISTAKES[0]}", "fmt nowhere.L README.md"],
    },
    "build": {
        **_of_missions("build {0} -o OUT/mission.lfm", "inspect OUT/mission.lfm"),
        "program": [f"build {SERVER}.L -o OUT/mission.lb", "disasm OUT/mission.lb"],
        "fakes": [f"build {LIFT}.dL --sim -o OUT/mission.lfm", "inspect OUT/mission.lfm"],
        "other bindings": [
            f"build {SERVER}.dL -o OUT/mission.lfm",
            "build OUT/mission.lfm",
            "build OUT/mission.lfm --sim -o OUT/other.lfm",
            f"build {SERVER}.L --sim",
        ],
        "no such folder": [f"build {SERVER}.dL -o OUT/nowhere/mission.lfm"],
        "mistakes": [f"build {_MISTAKES[0]}"],
    },
    "disasm": {
        **_of_missions("disasm {0}", "disasm --wasm {0}"),
        "0.3": ["disasm tests/formats/program-0.3.lb"],
        "no program": ["disasm README.md", "disasm nowhere.lb"],
    },
    "inspect": {
        "deployment": [f"inspect {SERVER}.dL"],
        "dump": ["inspect tests/formats/dump-0.3.block", "inspect tests/formats/dump-0.3.block --json"],
        "program": [f"inspect {SERVER}.L", f"inspect {SERVER}.L --json"],
        "no such file": ["inspect nowhere", "inspect tests", "inspect README.md"],
    },
    "keys": {
        "a team": [
            "keys init OUT/authority",
            "keys host yard air --authority OUT/authority",
            "keys person anna --may stop,operate --authority OUT/authority",
            "keys page desk.local --authority OUT/authority",
            "keys list --authority OUT/authority",
            "keys show OUT/authority/hosts/yard",
            "keys renew host yard --authority OUT/authority",
            "keys revoke person anna --authority OUT/authority",
            "keys list --authority OUT/authority",
        ],
        "refused": [
            "keys list --authority OUT/nowhere",
            "keys show OUT/nowhere",
            "keys host yard --authority OUT/nowhere",
            "keys init OUT/authority",
            "keys init OUT/authority",
            "keys person anna --may fly --authority OUT/authority",
        ],
    },
    "sign": {
        "a bundle": [
            "keys init OUT/authority",
            "keys person anna --may command --authority OUT/authority",
            f"build {SERVER}.dL -o OUT/mission.lfm",
            "sign OUT/mission.lfm --keys OUT/authority/people/anna",
            "inspect OUT/mission.lfm",
        ],
        "refused": [
            "sign OUT/nowhere.lfm --keys OUT/nowhere",
            f"build {SERVER}.dL -o OUT/mission.lfm",
            "sign OUT/mission.lfm --keys OUT/nowhere",
        ],
    },
    "capabilities": {
        "tree": ["capabilities tree", "capabilities tree manipulation", "capabilities tree nothing"],
        "show": [
            "capabilities show Lift",
            "capabilities show Lift --L",
            "capabilities show Lift --L --program",
            "capabilities show payload",
            "capabilities show Copter",
            "capabilities show nothing",
        ],
        "check": [
            "capabilities check",
            f"capabilities check {LIFT}.capabilities.yaml --program {LIFT}.dL",
            f"capabilities check {_REGISTRY_MISTAKES}",
            "capabilities check nowhere.yaml",
        ],
    },
    "query": {
        "files": [
            f'query "Lift where payload >= 2.0" {LIFT}.dL --files',
            f'query "Lift where payload >= 2.0" {LIFT}.dL --files --explain',
            f'query "Lift where payload >= 2.0" {LIFT}.dL --files --json',
            f"query Lift {LIFT}.dL --files --team 2",
            f"query Lift {LIFT}.dL --files --team 2 --json",
            f'query "Lift where payload >= 1000.0" {LIFT}.dL --files --json',
        ],
        "refused": [
            f"query Lft {LIFT}.dL --files",
            f'query "Lift where payload >" {LIFT}.dL --files',
            f"query Lift {LIFT}.dL --files --at nowhere",
            "query Lift",
        ],
    },
    "driver": {
        "list": ["driver list", "driver list --json"],
        "new": [
            "driver new winch --into OUT/winch",
            "driver new winch --into OUT/winch",
            "driver new 2 --into OUT/2",
        ],
    },
    "setup": {
        "refused": [
            "setup",
            "setup nothing",
            f"setup --deploy {SERVER}.dL",
            "setup --deploy nowhere.dL",
        ]
    },
    "kit": {"refused": ["kit", "kit nothing", "kit mavlink --type Nothing"]},
    "sim": {
        "refused": [
            "sim",
            "sim nothing",
            "sim fault",
            "sim fault nowhere battery=0",
            "sim mavlink --kind submarine",
        ]
    },
    "up": {
        "refused": [
            "up",
            f"up {SERVER}.dL",
            f"up {SERVER}.dL --host nowhere",
            f"up {SERVER}.dL --all --lost-after soon",
            f"up {SERVER}.dL --all --engine diesel",
        ]
    },
    "lfield": {
        "version": ["--version"],
        "refused": ["", "fly", "ps --deploy", "ps ''", f"ps --deploy {SERVER}.dL --deploy {LIFT}.dL"],
    },
    "nothing runs": {
        name: [name]
        for name in (
            *("ps", "ps --json", "watch", "events", "logs", "query Lift", "estop"),
            *("start", "pause", "resume", "forget tom", "recover tom"),
        )
    },
}
