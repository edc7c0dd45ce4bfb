"""Lowering of bytecode to WebAssembly text: control-flow graph, control structure, instructions, module."""
