"""Who can do this: the registry of capabilities, what fits a wish, what is equivalent (DESIGN section 8).

Chapter IV of the thesis lists the primitives; finding equivalent ones was left as future work in chapter V.
"""
