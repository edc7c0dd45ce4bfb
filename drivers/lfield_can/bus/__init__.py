"""The CAN bus: frames in and out, by python-can or socketcand, reopened after a loss."""
