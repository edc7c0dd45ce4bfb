"""From bytecode to WebAssembly, as text: the graph of a method, its control, its instructions, a module."""
