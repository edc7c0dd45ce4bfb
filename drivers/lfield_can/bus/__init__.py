"""The CAN bus: frames in and out, over python-can or socketcand, opened again after it was lost."""
