"""The command lfield: main and one file per command."""
