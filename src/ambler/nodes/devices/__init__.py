"""One node per kind of device: it opens the device, reads it in its rhythm, publishes what came, and tells how the device does."""
