"""Real devices behind the Protocols of `core/devices.py`: a base over a serial line, a joystick, sensors over a local socket."""
