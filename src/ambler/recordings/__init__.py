"""Recordings as sources: recorded devices behind the Protocols of `core/devices.py`."""
