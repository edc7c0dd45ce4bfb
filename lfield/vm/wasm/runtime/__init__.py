"""The machine's own work on blocks, written in WebAssembly text: collector, copy, soundness, strings."""
