"""lfield: one program for a team of robots.

The language L, its compiler, the mobile virtual machine and the runtime that binds it to hardware.
`lfield/docs/architecture.md` shows the layers.
"""

__version__ = "0.4.0"
