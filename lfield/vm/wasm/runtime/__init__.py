"""Runtime in WebAssembly text: garbage collector, deep copy, verifier, strings."""
