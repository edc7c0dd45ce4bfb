"""Two engines do the same, instruction for instruction and byte for byte: random programs that would tell."""
