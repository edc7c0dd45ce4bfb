"""The run time of whole commands that compile.

The programs: ten kernels; the stock resources of three drivers; and the same with a registry of 100 more
capability types, of which none or all are used.
"""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.paced import Round, whole_run
from harness.processes import Processes
from harness.samples import Contender

TYPES = range(100)

_REGISTRY = """\
registry: 1
taxonomy:
  skill: {{meaning: behaviours}}
{terms}primitives:
{primitives}providers:
  Copter:
    serves:
{serves}"""
_PRIMITIVE = """\
  Act%d:
    id: skill.act%d
    portals:
      go: {parameters: {height: {type: real, unit: m, meaning: how high}}, emit: real, unit: m}
      stop: {meaning: ends it}
"""


def command(subcommand: str) -> Opener:
    """Run a subcommand on each program."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        folder = processes.folder()
        programs = [_write(folder, name, *source) for name, source in _programs().items()]

        def took() -> Round:
            with Processes() as own:
                found: Round = {}
                for path in programs:
                    found |= whole_run(checkout.lfield(own, subcommand, str(path)), path.stem)
                return found

        return took

    return opener


def _write(folder: Path, name: str, text: str, registry: str) -> Path:
    path = folder / f"{name}.L"
    path.write_text(text, encoding="utf-8")
    if registry:
        path.with_suffix(".capabilities.yaml").write_text(registry, encoding="utf-8")
    return path


def _programs() -> dict[str, tuple[str, str]]:
    """L text and registry of each program, by name."""
    kernels = Path(__file__).with_name("kernels.L").read_text(encoding="utf-8")
    stock = (Checkout.own().root / "examples/03-mixed-team/mission.L").read_text(encoding="utf-8")
    calls = "".join(
        f'        Act{n}[] who{n} = findAct{n}("agent != host"); who{n}[0].go(1.0);\n' for n in TYPES
    )
    asker = f"coordinator Asker {{\n    init(string[] arg) {{\n{calls}    }}\n}}\n"
    registry = _REGISTRY.format(
        terms="".join(f"  skill.act{n}: {{meaning: does number {n}}}\n" for n in TYPES),
        primitives="".join(_PRIMITIVE % (n, n) for n in TYPES),
        serves="".join(f"      Act{n}: {{portals: {{go: climb, stop: land}}}}\n" for n in TYPES),
    )
    return {
        "the ten kernels": (kernels, ""),
        "03-mixed-team": (stock, ""),
        f"it, {len(TYPES)} types, none used": (stock, registry),
        f"it, {len(TYPES)} types, all used": (stock + asker, registry),
    }


FIGURE = Figure(
    "Compiling: a command from its start to its end",
    {"lfield check": command("check"), "lfield build": command("build")},
    rounds=4,
    one_size="four given programs; `compiler` has lines by number",
    targets={f"it, {len(TYPES)} types, none used": "as without"},
    between=("lfield check", "lfield build"),
)
