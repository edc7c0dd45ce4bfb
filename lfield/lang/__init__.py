"""The front end: text to checked tree, independent of bytecode."""
