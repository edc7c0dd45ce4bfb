"""The language server: LSP messages to the workspace, and its answers back."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from cattrs import transform_error
from lsprotocol import types
from pygls import uris
from pygls.exceptions import JsonRpcException, JsonRpcInvalidParams
from pygls.lsp.server import LanguageServer
from pygls.protocol import LanguageServerProtocol, default_converter
from pygls.protocol.json_rpc import JsonRPCRequestMessage

from lfield import __version__
from lfield.editor.outline import OutlineEntry
from lfield.editor.program_parts import file_offsets
from lfield.editor.text_places import LineIndex, TextPlace
from lfield.editor.workspace import Workspace
from lfield.errors import LfieldError, UsageError
from lfield.text.source_text import Diagnostic

_SEVERITIES = {"error": types.DiagnosticSeverity.Error, "warning": types.DiagnosticSeverity.Warning}
_COMPLETION = types.CompletionItemKind
_COMPLETION_KINDS = {
    "unit": _COMPLETION.Class,
    "enum": _COMPLETION.Enum,
    "member": _COMPLETION.EnumMember,
    "constant": _COMPLETION.Constant,
    "function": _COMPLETION.Function,
    "resource": _COMPLETION.Interface,
    "coordinator": _COMPLETION.Module,
    "device": _COMPLETION.Interface,
    "builtin": _COMPLETION.Class,
    "method": _COMPLETION.Method,
    "instruction": _COMPLETION.Method,
    "library": _COMPLETION.Function,
    "field": _COMPLETION.Field,
    "local": _COMPLETION.Variable,
    "keyword": _COMPLETION.Keyword,
    "file": _COMPLETION.File,
    "agent": _COMPLETION.Reference,
    "host": _COMPLETION.Value,
}
_OUTLINE_KINDS = {
    "resource": types.SymbolKind.Interface,
    "coordinator": types.SymbolKind.Module,
    "class": types.SymbolKind.Class,
    "field": types.SymbolKind.Field,
    "constructor": types.SymbolKind.Constructor,
    "init": types.SymbolKind.Constructor,
    "enum": types.SymbolKind.Enum,
    "member": types.SymbolKind.EnumMember,
    "constant": types.SymbolKind.Constant,
    "function": types.SymbolKind.Function,
    "agent": types.SymbolKind.Object,
    "witness": types.SymbolKind.Object,
}
#: Handles requests with malformed parameters.
_MALFORMED = "lfield/malformed"
#: Checks between two collections of garbage.
_CHECKS_PER_COLLECTION = 50
_JsonObject = dict[str, object]


class _Symbols(list[_JsonObject]):
    """An outline as JSON: the conversion of thousands of symbols takes longer than their outline."""


def _converter() -> Any:
    """The converter of pygls, except for outlines."""
    # The function of pygls has no types.
    converter: Any = default_converter()  # type: ignore[no-untyped-call]
    converter.register_unstructure_hook(_Symbols, lambda symbols: symbols)
    return converter


class _Protocol(LanguageServerProtocol):
    """The protocol of pygls, which leaves a request with malformed parameters without an answer."""

    def structure_message(self, data: dict[str, Any]) -> Any:
        """The message; for a malformed request one to the handler that refuses it."""
        try:
            return super().structure_message(data)
        except JsonRpcException as error:
            if not {"id", "method"} <= data.keys():
                raise
            reasons = [] if error.__cause__ is None else transform_error(error.__cause__, data["method"])
            refusal = JsonRpcInvalidParams("; ".join(reasons) or str(error))
            return JsonRPCRequestMessage(data["id"], _MALFORMED, "2.0", refusal)


class LfieldServer:
    """The handlers of one server with one workspace.

    The server itself collects garbage, between answers. Remaining objects are exempt from later collections:
    otherwise each collection would scan the syntax trees of all texts, and delay an answer by a second.
    """

    def __init__(self, workspace: Workspace) -> None:
        self.server = LanguageServer(
            "lfield", __version__, protocol_cls=_Protocol, converter_factory=_converter
        )
        self._workspace = workspace
        self._checking: asyncio.Task[None] | None = None
        self._index: tuple[str, LineIndex] | None = None
        self._checks = 0
        #: The URIs of open texts by editors: a text without a file has no other URI.
        self._uris: dict[Path, str] = {}
        gc.disable()
        handlers: dict[str, Callable[[Any], Any]] = {
            types.TEXT_DOCUMENT_DID_OPEN: self.on_open,
            types.TEXT_DOCUMENT_DID_CHANGE: self.on_change,
            types.TEXT_DOCUMENT_DID_CLOSE: self.on_close,
            types.TEXT_DOCUMENT_DID_SAVE: self.on_files_changed,
            types.WORKSPACE_DID_CHANGE_WATCHED_FILES: self.on_files_changed,
            types.TEXT_DOCUMENT_HOVER: self.hover,
            types.TEXT_DOCUMENT_DEFINITION: self.definition,
            types.TEXT_DOCUMENT_REFERENCES: self.references,
            types.TEXT_DOCUMENT_RENAME: self.rename,
            types.TEXT_DOCUMENT_FORMATTING: self.formatting,
            types.TEXT_DOCUMENT_DOCUMENT_SYMBOL: self.document_symbols,
        }
        handlers[_MALFORMED] = _refuse
        for feature, handler in handlers.items():
            self.server.feature(feature)(_function(handler))
        triggers = types.CompletionOptions(trigger_characters=[".", "<", "/", "@", "?", "&"])
        self.server.feature(types.TEXT_DOCUMENT_COMPLETION, triggers)(_function(self.completion))

    # --- texts ------------------------------------------------------------------------------------------

    def on_open(self, params: types.DidOpenTextDocumentParams) -> None:
        """Handle a text that was opened."""
        self._put(params.text_document.uri)

    def on_change(self, params: types.DidChangeTextDocumentParams) -> None:
        """Handle a text that was edited."""
        self._put(params.text_document.uri)

    def on_close(self, params: types.DidCloseTextDocumentParams) -> None:
        """Handle a text that was closed."""
        path = _path(params.text_document.uri)
        self._publish(self._workspace.close(path))
        self._uris.pop(path, None)
        self._check_later()

    def on_files_changed(
        self, params: types.DidSaveTextDocumentParams | types.DidChangeWatchedFilesParams
    ) -> None:
        """Handle a file that was saved, or changed on the disk."""
        if isinstance(params, types.DidChangeWatchedFilesParams):
            self._workspace.reload(_path(change.uri) for change in params.changes)
            self._check_later()

    def _put(self, uri: str) -> None:
        path = _path(uri)
        self._uris[path] = uri
        self._workspace.put(path, self.server.workspace.get_text_document(uri).source)
        self._check_later()

    def _check_later(self) -> None:
        """Check the outdated parts, one by one, between other messages."""
        if self._checking is None or self._checking.done():
            self._checking = asyncio.get_running_loop().create_task(self._check())

    async def _check(self) -> None:
        await asyncio.sleep(0)
        while (changed := self._workspace.step()) is not None:
            self._publish(changed)
            await asyncio.sleep(0)
        if self._checks % _CHECKS_PER_COLLECTION == 0:
            gc.collect()
            gc.freeze()
        self._checks += 1

    def _publish(self, changed: Mapping[Path, list[Diagnostic]]) -> None:
        for path, findings in changed.items():
            index = self._line_index(path)
            uri = self._uri(path)
            document = self.server.workspace.text_documents.get(uri)
            self.server.text_document_publish_diagnostics(
                types.PublishDiagnosticsParams(
                    uri,
                    [_diagnostic(finding, index) for finding in findings],
                    version=None if document is None else document.version,
                )
            )

    def _uri(self, path: Path) -> str:
        return self._uris.get(path) or uris.from_fs_path(str(path)) or str(path)

    # --- places -----------------------------------------------------------------------------------------

    def _line_index(self, path: Path) -> LineIndex:
        text = self._workspace.text(path)
        if self._index is None or self._index[0] is not text:
            is_utf16 = self.server.workspace.position_encoding in (None, types.PositionEncodingKind.Utf16)
            self._index = text, LineIndex(text, is_utf16=is_utf16)
        return self._index[1]

    def _place(self, document: types.TextDocumentIdentifier, at: types.Position) -> tuple[Path, int]:
        path = _path(document.uri)
        return path, self._line_index(path).offset(at.line, at.character)

    def _locations(self, places: Iterable[TextPlace]) -> list[types.Location]:
        return [
            types.Location(
                self._uri(place.path), _range(self._line_index(place.path), place.start, place.end)
            )
            for place in places
        ]

    # --- requests ---------------------------------------------------------------------------------------

    def hover(self, params: types.HoverParams) -> types.Hover | None:
        """The signature and documentation of a name."""
        text = self._workspace.hover(*self._place(params.text_document, params.position))
        return types.Hover(types.MarkupContent(types.MarkupKind.Markdown, text)) if text else None

    def completion(self, params: types.CompletionParams) -> types.CompletionList:
        """The completions for a position."""
        proposals = self._workspace.complete(*self._place(params.text_document, params.position))
        items = [
            types.CompletionItem(
                proposal.text,
                kind=_COMPLETION_KINDS.get(proposal.kind, _COMPLETION.Text),
                detail=proposal.detail or None,
                documentation=types.MarkupContent(types.MarkupKind.Markdown, proposal.documentation)
                if proposal.documentation
                else None,
            )
            for proposal in proposals
        ]
        return types.CompletionList(is_incomplete=False, items=items)

    def definition(self, params: types.DefinitionParams) -> list[types.Location]:
        """The declaration of a name."""
        return self._locations(
            self._workspace.definitions(*self._place(params.text_document, params.position))
        )

    def references(self, params: types.ReferenceParams) -> list[types.Location]:
        """All places of a name."""
        return self._locations(
            self._workspace.references(*self._place(params.text_document, params.position))
        )

    def rename(self, params: types.RenameParams) -> types.WorkspaceEdit:
        """The edits of a renaming."""
        try:
            edits = self._workspace.rename(
                *self._place(params.text_document, params.position), params.new_name
            )
        except UsageError as error:
            raise JsonRpcInvalidParams(str(error)) from None
        changes: dict[str, list[types.TextEdit]] = {}
        for edit in edits:
            place = edit.place
            where = _range(self._line_index(place.path), place.start, place.end)
            changes.setdefault(self._uri(place.path), []).append(types.TextEdit(where, edit.text))
        return types.WorkspaceEdit(changes=changes)

    def formatting(self, params: types.DocumentFormattingParams) -> list[types.TextEdit]:
        """The edit that formats a text; none if it has syntax errors."""
        path = _path(params.text_document.uri)
        before = self._workspace.text(path)
        try:
            after = self._workspace.format(path)
        except LfieldError:
            return []
        if after == before:
            return []
        return [types.TextEdit(_range(self._line_index(path), 0, len(before)), after)]

    def document_symbols(self, params: types.DocumentSymbolParams) -> _Symbols:
        """The outline of a text."""
        path = _path(params.text_document.uri)
        index = self._line_index(path)
        return _Symbols(_document_symbol(entry, index) for entry in self._workspace.outline(path))


def _refuse(refusal: JsonRpcInvalidParams) -> None:
    """Answer a request with malformed parameters."""
    raise refusal


def _function(handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A method as a function, to which pygls adds attributes."""

    def handle(params: Any) -> Any:
        return handler(params)

    return handle


def _path(uri: str) -> Path:
    path = Path(uris.to_fs_path(uri) or uri)
    # A root is no file.
    return path if path.name else Path("untitled:")


def _range(index: LineIndex, start: int, end: int) -> types.Range:
    return types.Range(types.Position(*index.position(start)), types.Position(*index.position(end)))


def _diagnostic(finding: Diagnostic, index: LineIndex) -> types.Diagnostic:
    hint = f"\n{finding.hint}" if finding.hint else ""
    return types.Diagnostic(
        _range(index, *file_offsets(finding.span)),
        finding.message + hint,
        severity=_SEVERITIES.get(finding.severity, types.DiagnosticSeverity.Information),
        code=finding.code,
        source="lfield",
    )


def _document_symbol(entry: OutlineEntry, index: LineIndex) -> _JsonObject:
    return {
        "name": entry.name,
        "detail": entry.detail,
        "kind": _OUTLINE_KINDS.get(entry.kind, types.SymbolKind.Method).value,
        "range": _json_range(index, entry.start, entry.end),
        "selectionRange": _json_range(index, entry.name_start, entry.name_end),
        "children": [_document_symbol(child, index) for child in entry.children],
    }


def _json_range(index: LineIndex, start: int, end: int) -> _JsonObject:
    (line, column), (last, after) = index.position(start), index.position(end)
    return {"start": {"line": line, "character": column}, "end": {"line": last, "character": after}}
