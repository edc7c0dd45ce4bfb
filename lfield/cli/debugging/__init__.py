"""`lfield debug`: the front ends of the time-travel debugger."""
