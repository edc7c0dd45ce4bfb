"""The events of many hosts in one order. Pure (decisions 65 and 92)."""
