// The language server `lfield lsp` and the debug adapter `lfield debug --dap` for VS Code.
"use strict";

const vscode = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

function command() {
    return vscode.workspace.getConfiguration("lfield").get("command") || "lfield";
}

function activate(context) {
    const server = { command: command(), args: ["lsp"] };
    client = new LanguageClient("lfield", "lfield", server, {
        documentSelector: [
            { scheme: "file", language: "l" },
            { scheme: "untitled", language: "l" },
            { scheme: "file", language: "l-deployment" },
        ],
        synchronize: { fileEvents: vscode.workspace.createFileSystemWatcher("**/*.{L,dL,yaml}") },
    });
    client.start();
    context.subscriptions.push(
        vscode.debug.registerDebugAdapterDescriptorFactory("lfield", {
            createDebugAdapterDescriptor() {
                return new vscode.DebugAdapterExecutable(command(), ["debug", "--dap"]);
            },
        }),
    );
}

function deactivate() {
    return client === undefined ? undefined : client.stop();
}

module.exports = { activate, deactivate };
