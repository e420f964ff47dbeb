"""Types that say a unit. Numbers are SI without one; angles say that they are, because files may tell those in degrees."""

from __future__ import annotations

from typing import Annotated

RADIANS = "rad"
Radians = Annotated[float, RADIANS]
"""An angle in radians, or how fast it changes, per second or per metre. A profile may hold the field `<name>` as `<name>_deg`."""
