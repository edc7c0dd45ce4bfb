"""The programs and deployments that an editor has open: texts and requests in, answers out.

The workspace itself reads no files (`FileReader`), and has no thread: the server calls `step` while no
request waits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from lfield.editor import deployment_text
from lfield.editor.completion import CompletionProposal, completions
from lfield.editor.cursor import cursor_at
from lfield.editor.layout.formatter import format_deployment, format_program
from lfield.editor.outline import OutlineEntry, deployment_outline, program_outline
from lfield.editor.program_model import ProgramEnvironment, ProgramModel
from lfield.editor.program_parts import file_offsets
from lfield.editor.references import references, renamed_places, symbol_at
from lfield.editor.symbol_text import hover_text
from lfield.editor.symbols_in_text import TextSymbol, TextSymbols
from lfield.editor.text_places import TextEdit, TextPlace
from lfield.errors import UsageError
from lfield.lang import tree
from lfield.lang.scanner import TokenKind
from lfield.lang.types import DeviceType
from lfield.text.source_text import Diagnostic, Source

PROGRAM, DEPLOYMENT = ".L", ".dL"
#: The other files of a mission, which may name units and members.
_OTHER_FILES = (".devices.yaml", ".capabilities.yaml", ".access.yaml")


class FileReader(Protocol):
    """Files on the disk."""

    def read(self, path: Path) -> str | None:
        """The text of a file, None if it cannot be read."""

    def names(self, folder: Path) -> Sequence[str]:
        """The names of the files in a folder."""


class Workspace:
    """Open texts by their path, with the programs that they belong to."""

    def __init__(self, files: FileReader, environment: ProgramEnvironment) -> None:
        self._files, self._environment = files, environment
        self._texts: dict[Path, str] = {}
        self._models: dict[Path, ProgramModel] = {}
        self._roots: dict[Path, Path] = {}
        #: The programs and deployments whose findings are out of date; the latest edit is last.
        self._stale: dict[Path, Path] = {}
        #: Of those, the ones of which no part was checked since the last edit.
        self._edited: set[Path] = set()
        self._published: dict[Path, list[Diagnostic]] = {}

    # --- texts ------------------------------------------------------------------------------------------

    def put(self, path: Path, text: str) -> None:
        """Store a text that was opened or edited."""
        is_new = path not in self._texts
        self._texts[path] = text
        if is_new:
            self._roots.clear()
        if path.suffix == DEPLOYMENT:
            self._mark(path, path)
            return
        roots = {self._root(path), *(root for root, model in self._models.items() if path in model.files)}
        for root in roots:
            self._mark(root, path)
            for deployment in self._texts:
                if deployment.suffix == DEPLOYMENT and deployment.with_suffix(PROGRAM) == root:
                    self._mark(deployment, deployment)

    def reload(self, changed: Iterable[Path]) -> None:
        """Read the files that have changed on the disk; an open text counts in place of its file."""
        unknown = [path for path in changed if path not in self._texts]
        if any(path.suffix not in (PROGRAM, DEPLOYMENT) for path in unknown):
            self._forget(self._models)
        if unknown:
            self._check_again()

    def close(self, path: Path) -> Mapping[Path, list[Diagnostic]]:
        """Close a text; its file counts again.

        Returns no findings for the files that had some and belong to no open text any longer.
        """
        self._texts.pop(path, None)
        self._stale.clear()
        self._check_again()
        needed = {self._root(file) if file.suffix != DEPLOYMENT else _program(file) for file in self._texts}
        self._forget([root for root in self._models if root not in needed])
        used = {*self._texts, *(file for model in self._models.values() for file in model.files)}
        obsolete = [file for file in self._published if file not in used]
        for file in obsolete:
            del self._published[file]
        return {file: [] for file in obsolete}

    def _forget(self, roots: Iterable[Path]) -> None:
        for root in list(roots):
            self._models.pop(root).dismantle()

    def _check_again(self) -> None:
        self._roots.clear()
        for path in self._texts:
            self._mark(path if path.suffix == DEPLOYMENT else self._root(path), path)

    def text(self, path: Path) -> str:
        """The text of a file, '' if there is none."""
        return self._read(path) or ""

    def _read(self, path: Path) -> str | None:
        return self._texts[path] if path in self._texts else self._files.read(path)

    def _mark(self, root: Path, edited: Path) -> None:
        self._stale.pop(root, None)
        self._stale[root] = edited
        self._edited.add(root)

    def _root(self, path: Path) -> Path:
        """The first file of the program that a file belongs to: one with a deployment, or one that includes
        the file."""
        if path not in self._roots:
            if path.suffix not in (PROGRAM, ""):
                # A devices file, for example: that of a program beside it.
                return path.with_name(path.name.partition(".")[0] + PROGRAM)
            names = self._files.names(path.parent)
            includes = re.compile(rf'^\s*include\s*"(\./)?{re.escape(path.name)}"', re.MULTILINE)
            owner = path
            if path.with_suffix(DEPLOYMENT).name not in names:
                programs = (path.parent / name for name in names if name.endswith(PROGRAM))
                owner = next((program for program in programs if includes.search(self.text(program))), path)
            self._roots[path] = owner
        return self._roots[path]

    def model(self, path: Path) -> ProgramModel:
        """The program of a file, with its present declarations."""
        root = self._root(path)
        if root not in self._models:
            self._models[root] = ProgramModel(root, self._read, self._environment)
        model = self._models[root]
        model.update()
        return model

    def _program_of(self, deployment: Path) -> ProgramModel | None:
        program = _program(deployment)
        return None if self._read(program) is None else self.model(program)

    # --- findings ---------------------------------------------------------------------------------------

    def step(self) -> Mapping[Path, list[Diagnostic]] | None:
        """Check one outdated part, the text edited last first.

        Returns the findings that have changed, after the first and the last part after an edit; after the
        last one also those of the edited file. None if no part is outdated.
        """
        if not self._stale:
            return None
        root, edited = next(reversed(self._stale.items()))
        if root.suffix == DEPLOYMENT:
            del self._stale[root]
            found = deployment_text.deployment_findings(self.text(root), str(root), self._program_of(root))
            return self._changed({root: found}, root)
        model = self.model(edited)
        is_last = not model.step(edited)
        if is_last:
            del self._stale[root]
        elif root not in self._edited:
            return {}
        self._edited.discard(root)
        by_path: dict[Path, list[Diagnostic]] = {path: [] for path in model.files}
        for finding in model.findings():
            path = model.path_of(finding.span.source.name)
            if path is not None:
                by_path[path].append(finding)
        return self._changed(by_path, edited if is_last else None)

    def _changed(
        self, found: Mapping[Path, list[Diagnostic]], checked: Path | None
    ) -> dict[Path, list[Diagnostic]]:
        """The findings that differ from those of the last time, and those of a file that is checked."""
        changed = {
            path: findings
            for path, findings in found.items()
            if (findings or path in self._published or path in self._texts)
            and (path == checked or findings != self._published.get(path))
        }
        self._published.update(changed)
        return changed

    # --- requests ---------------------------------------------------------------------------------------

    def hover(self, path: Path, offset: int) -> str:
        """The documentation of the name at an offset, as Markdown; '' for none."""
        if path.suffix == DEPLOYMENT:
            name = deployment_text.name_at(self.text(path), offset)
            symbol = self._type_in_deployment(path, name)
            if symbol is not None:
                return self._hover_of(_program(path), symbol)
            return "" if name is None else deployment_text.hover_of_name(name, self.text(path))
        symbol = symbol_at(self.model(path), path, offset)
        return "" if symbol is None else self._hover_of(path, symbol)

    def _hover_of(self, path: Path, symbol: TextSymbol) -> str:
        declared = None if symbol.span is None else self.model(path).path_of(symbol.span.source.name)
        return hover_text(symbol, None if declared is None else self.text(declared))

    def complete(self, path: Path, offset: int) -> list[CompletionProposal]:
        """The completions for an offset."""
        if path.suffix == DEPLOYMENT:
            model = self._program_of(path)
            return deployment_text.deployment_completions(self.text(path), offset, model)
        return completions(self.model(path), path, offset)

    def definitions(self, path: Path, offset: int) -> list[TextPlace]:
        """The declarations of the name at an offset.

        From its declaration in a program, a resource or coordinator leads to its lines in the deployment, a
        device to its bindings in the devices file, and an id in a text to its line.
        """
        if path.suffix == DEPLOYMENT:
            return self._definitions_in_deployment(path, offset)
        model = self.model(path)
        cursor = cursor_at(model, path, offset)
        if cursor is None:
            return []
        start = file_offsets(cursor.token.span)[0]
        for part in model.files[path].parts:
            for include in part.file.includes:
                first, last = file_offsets(include.span)
                target = model.included(include, path)
                if first <= start <= last and target is not None:
                    return [TextPlace(target, 0, 0)]
        symbol = symbol_at(model, path, offset)
        if cursor.token.kind is TokenKind.STRING and symbol is None:
            return self._agents(model.root, "id", str(cursor.token.value))
        declared = None if symbol is None else self._declaration(model, symbol)
        if symbol is None or declared is None:
            return []
        if (declared.path, declared.start) == (path, start):
            return self._uses_in_mission(model, symbol) or [declared]
        return [declared]

    def _declaration(self, model: ProgramModel, symbol: TextSymbol) -> TextPlace | None:
        if symbol.span is None or (path := model.path_of(symbol.span.source.name)) is None:
            return None
        return TextPlace(path, *file_offsets(symbol.span))

    def _uses_in_mission(self, model: ProgramModel, symbol: TextSymbol) -> list[TextPlace]:
        """The lines of a unit in the deployment, or the bindings of a device in the devices file."""
        if isinstance(symbol.meaning, tree.Unit):
            return self._agents(model.root, "type", symbol.name)
        if not (isinstance(symbol.meaning, tree.Field) and isinstance(symbol.meaning.type, DeviceType)):
            return []
        devices = model.root.with_suffix(".devices.yaml")
        text, deployment = self._read(devices), self.text(model.root.with_suffix(DEPLOYMENT))
        agents = [
            e.id.text for e in deployment_text.deployment_entries(deployment) if e.type.text == symbol.owner
        ]
        spans = (
            span for agent in agents for span in deployment_text.device_keys(text or "", agent, symbol.name)
        )
        return [TextPlace(devices, span.start, span.end) for span in spans]

    def _agents(self, program: Path, kind: deployment_text.NameKind, name: str) -> list[TextPlace]:
        """The names of a kind in the deployment of a program."""
        path = program.with_suffix(DEPLOYMENT)
        names = deployment_text.names_in(self.text(path))
        return [
            TextPlace(path, entry.span.start, entry.span.end)
            for entry in names
            if (entry.kind, entry.span.text) == (kind, name)
        ]

    def _type_in_deployment(
        self, path: Path, name: deployment_text.DeploymentName | None
    ) -> TextSymbol | None:
        model = self._program_of(path) if name is not None and name.kind == "type" else None
        return None if model is None or name is None else TextSymbols(model).type_named(name.span.text)

    def _definitions_in_deployment(self, path: Path, offset: int) -> list[TextPlace]:
        name = deployment_text.name_at(self.text(path), offset)
        if name is None:
            return []
        if (symbol := self._type_in_deployment(path, name)) is not None:
            declared = self._declaration(self.model(_program(path)), symbol)
            return [] if declared is None else [declared]
        if name.kind == "id":
            devices = path.with_suffix(".devices.yaml")
            spans = deployment_text.device_keys(self._read(devices) or "", name.span.text)
            return [TextPlace(devices, span.start, span.end) for span in spans]
        kind: deployment_text.NameKind = "id" if name.kind == "argument" else "host"
        return self._agents(path, kind, name.span.text)[:1]

    def references(self, path: Path, offset: int) -> list[TextPlace]:
        """All places of the symbol at an offset, in program and deployment."""
        symbol, program = self._symbol(path, offset)
        if symbol is None or program is None:
            return []
        found = list(references(program, symbol))
        is_unit = isinstance(symbol.meaning, tree.Unit)
        return [*found, *(self._agents(program.root, "type", symbol.name) if is_unit else [])]

    def rename(self, path: Path, offset: int, name: str) -> list[TextEdit]:
        """The edits that give the symbol at an offset another name. Raises UsageError."""
        symbol, program = self._symbol(path, offset)
        if symbol is None or program is None:
            raise UsageError("no unit, member or variable of a program is here")
        others = {
            other: text
            for suffix in _OTHER_FILES
            if (text := self._read(other := program.root.with_suffix(suffix))) is not None
        }
        others |= self._other_programs(program)
        places = renamed_places(program, symbol, name, others)
        if isinstance(symbol.meaning, tree.Unit):
            places += self._agents(program.root, "type", symbol.name)
        return [TextEdit(place, name) for place in places]

    def _other_programs(self, program: ProgramModel) -> dict[Path, str]:
        """The programs in its folder that include a file of this program."""
        folder = program.root.parent
        paths = (folder / name for name in self._files.names(folder) if name.endswith(PROGRAM))
        texts = {path: self.text(path) for path in paths if path not in program.files}
        shared = re.compile("|".join(rf'"(?:\./)?{re.escape(path.name)}"' for path in program.files))
        return {path: text for path, text in texts.items() if shared.search(text)}

    def _symbol(self, path: Path, offset: int) -> tuple[TextSymbol | None, ProgramModel | None]:
        if path.suffix == DEPLOYMENT:
            name = deployment_text.name_at(self.text(path), offset)
            return self._type_in_deployment(path, name), self._program_of(path)
        model = self.model(path)
        return symbol_at(model, path, offset), model

    def outline(self, path: Path) -> list[OutlineEntry]:
        """The units of a program, or the agents of a deployment."""
        if path.suffix == DEPLOYMENT:
            return deployment_outline(deployment_text.deployment_entries(self.text(path)))
        file = self.model(path).files.get(path)
        return [] if file is None else program_outline(file)

    def format(self, path: Path) -> str:
        """The formatted text. Raises ProgramError for syntax errors."""
        source = Source(str(path), self.text(path))
        return format_deployment(source) if path.suffix == DEPLOYMENT else format_program(source)


def _program(deployment: Path) -> Path:
    """The program of a deployment."""
    return deployment.with_suffix(PROGRAM)
