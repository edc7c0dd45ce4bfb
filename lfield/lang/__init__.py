"""The front end: text to checked tree. Knows no bytecode."""
