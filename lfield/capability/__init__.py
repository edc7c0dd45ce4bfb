"""Capabilities: the registry, queries over agents, equivalent and composed offers.

Chapter IV of the thesis lists the primitives; finding equivalent ones was left as future work in chapter V.
"""
