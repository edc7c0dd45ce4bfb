"""A client of `lfield lsp` for tests: it sends messages to a server process and waits for the answers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self


class LspSession:
    """A server process and the messages that it has sent."""

    def __init__(self, folder: Path, encodings: tuple[str, ...] = ()) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lfield", "lsp"],
            cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        self.folder, self._last, self._version = folder, 0, 0
        self.requests = 0
        #: The version of each open text, and the latest diagnostics with their version.
        self._versions: dict[str, int] = {}
        self._diagnostics: dict[str, tuple[int, list[dict[str, Any]]]] = {}
        general = {"positionEncodings": list(encodings)} if encodings else {}
        self.capabilities = self.request(
            "initialize",
            {"processId": None, "rootUri": folder.as_uri(), "capabilities": {"general": general}},
        )["capabilities"]
        self.notify("initialized", {})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None and not stream.closed:
                stream.close()

    def end(self) -> int:
        """End the session in the same way as an editor. Return the exit status of the server."""
        self.request("shutdown", None)
        self.notify("exit", None)
        self.close_input()
        return self.wait()

    def close_input(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()

    def wait(self) -> int:
        """Wait for the end of the server. Return its exit status."""
        return self._process.wait(30)

    def processor_time(self) -> float:
        """CPU time of the server in seconds."""
        fields = (
            Path(f"/proc/{self._process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        )
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def notify(self, method: str, params: Any) -> None:
        self._send({"method": method, "params": params})

    def request(self, method: str, params: Any) -> Any:
        """Send a request. Return the result, or the error of a refused request."""
        self._last += 1
        self.requests += 1
        self._send({"id": self._last, "method": method, "params": params})
        while True:
            message = self._receive()
            if message.get("id") == self._last:
                return message["result"] if "result" in message else message["error"]

    def _send(self, message: Mapping[str, Any]) -> None:
        data = json.dumps({"jsonrpc": "2.0", **message}).encode()
        assert self._process.stdin is not None
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(data), data))
        self._process.stdin.flush()

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        length = 0
        while line := self._process.stdout.readline().strip():
            if line.lower().startswith(b"content-length:"):
                length = int(line.split(b":")[1])
        assert length, self._process.stderr.read().decode() if self._process.stderr else ""
        message: dict[str, Any] = json.loads(self._process.stdout.read(length))
        if message.get("method") == "textDocument/publishDiagnostics":
            name = message["params"]["uri"].rpartition("/")[2]
            self._diagnostics[name] = message["params"].get("version"), message["params"]["diagnostics"]
        return message

    # --- texts ------------------------------------------------------------------------------------------

    def document(self, name: str) -> dict[str, str]:
        return {"uri": (self.folder / name).as_uri()}

    def open(self, name: str, text: str | None = None) -> None:
        self._version += 1
        self._versions[name] = self._version
        content = (self.folder / name).read_text(encoding="utf-8") if text is None else text
        document = {**self.document(name), "languageId": "l", "version": self._version, "text": content}
        self.notify("textDocument/didOpen", {"textDocument": document})

    def change(self, name: str, line: int, column: int, removed: int, text: str) -> None:
        """Replace characters of a line."""
        self._version += 1
        self._versions[name] = self._version
        span = {
            "start": {"line": line, "character": column},
            "end": {"line": line, "character": column + removed},
        }
        self.notify(
            "textDocument/didChange",
            {
                "textDocument": {**self.document(name), "version": self._version},
                "contentChanges": [{"range": span, "text": text}],
            },
        )

    def await_diagnostics(self, name: str, version: int = 0) -> list[dict[str, Any]]:
        """Wait for the diagnostics of a version of a text: the present version, or the given one."""
        while self._diagnostics.get(name, (0, []))[0] != (version or self._versions[name]):
            self._receive()
        return self._diagnostics[name][1]

    def at(self, method: str, name: str, line: int, column: int, **more: Any) -> Any:
        """Send a request about a position. Return the result."""
        position = {"line": line, "character": column}
        return self.request(method, {"textDocument": self.document(name), "position": position, **more})
