"""What CARMEN's old laser lines leave out: the angles of the beams and the range of the scanner.

Both come from the log's parameters where they tell; else the angles from the number of beams, as CARMEN's own reader and GMapping's do.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from ambler.core.errors import BadInputError

_FULL_TURN_DEG = 360.0
_HOKUYO_STEP_DEG = 360.0 / 1024.0
# Steps in degrees: SICK LMS (1, 0.5 and 0.25), S300 (0.5), Hokuyo UTM (0.25) and URG (1024 to the turn).
_KNOWN_STEPS_DEG = {
    **dict.fromkeys((180, 181), 1.0),
    **dict.fromkeys((360, 361, 540, 541), 0.5),
    **dict.fromkeys((400, 401, 1080, 1081), 0.25),
    **dict.fromkeys((682, 683, 726, 769), _HOKUYO_STEP_DEG),
}
_HALF_TURN_DEG = 180.0
_AGREES = 0.01  # share by which two tellings of a step may differ and still be the same
_SIDES = {
    **dict.fromkeys(("FLASER", "ROBOTLASER1", "RAWLASER1"), "front"),
    **dict.fromkeys(("RLASER", "ROBOTLASER2", "RAWLASER2"), "rear"),
}
_FOV_DEG = (5.0, 360.0)
_STEP_DEG = (0.01, 10.0)
_RANGE = (0.5, 1000.0)  # metres


@dataclass(frozen=True, slots=True)
class BeamLayout:
    """Angle of the first beam and from beam to beam, radians; `doubt` says in words what is uncertain about them, or is empty."""

    angle_min: float
    angle_increment: float
    doubt: str = ""


def side_of(name: str) -> str | None:
    """Return `front` or `rear`, as CARMEN's parameters call the scanner of a line, or None for a third one."""
    return _SIDES.get(name)


def mount_parameter(name: str, parameters: dict[str, str]) -> float | None:
    """Return the scanner's offset along the base's x axis, metres, or None; raises BadInputError where it is no number."""
    side = side_of(name)
    text = None if side is None else parameters.get(f"robot_{side}laser_offset")
    if text is None:
        return None
    try:
        offset = float(text)
    except ValueError:
        offset = math.nan
    if not math.isfinite(offset):
        raise BadInputError(f"laser offset {text!r} is no number (--mount X,Y,YAW tells where the scanner is)")
    return offset


def told_range(name: str, parameters: dict[str, str]) -> float:
    """Return the scanner's range by the parameters, metres, or inf."""
    value = _told(name, "max|maxrange|max_range", parameters, _RANGE)
    return math.inf if value is None else value


def layout_of(name: str, beams: int, parameters: dict[str, str]) -> BeamLayout:
    """Return the angles of an old line's beams: by the parameters, else by how many there are, else over 180 degrees.

    An even number lacks the last beam of the odd one above it, as with SICK's 180 of 181; Hokuyo's beams lie evenly about the x axis.
    """
    known = _KNOWN_STEPS_DEG.get(beams)
    gaps = max(1, beams - 1 if beams % 2 or known == _HOKUYO_STEP_DEG else beams)
    told, doubt = _told_step(name, beams, gaps, parameters)
    step = known
    if told is not None and (known is None or abs(told / known - 1.0) > _AGREES):
        step = told
        if known is not None:
            doubt = (
                f"{beams} beams are {_degrees(told * gaps)} by its parameters, not {_degrees(known * gaps)} as usual"
            )
    if step is None:
        step = _HALF_TURN_DEG / gaps
        if not doubt:
            doubt = f"{beams} beams are those of no known scanner"
        doubt += "; they are taken to cover 180 degrees (PARAM laser_front_laser_fov tells otherwise)"
    span = step * gaps
    return BeamLayout(-0.5 * math.radians(span), math.radians(step), doubt and f"{name}: {doubt}")


def _told_step(name: str, beams: int, gaps: int, parameters: dict[str, str]) -> tuple[float | None, str]:
    """Return degrees from beam to beam by the parameters, and what is odd about them."""
    step = _told(name, "resolution", parameters, _STEP_DEG)
    fov = _told(name, "fov", parameters, _FOV_DEG)
    if step is not None and step * (beams - 1) > _FULL_TURN_DEG:
        step = None
    if step is None:
        return None if fov is None else fov / gaps, ""
    if fov is not None and abs(fov / step - gaps) > 1.5:
        return None, f"{beams} beams do not fit its parameters, {fov:g} degrees in steps of {step:g}"
    return step, ""


def _told(name: str, quantity: str, parameters: dict[str, str], limits: tuple[float, float]) -> float | None:
    """Return a parameter of the scanner by any of its spellings over the years, if it is a number within the limits."""
    side = side_of(name)
    if side is None:
        return None
    pattern = re.compile(rf"(laser|robot)_{side}_?laser_({quantity})")
    for key in sorted(parameters):
        if not pattern.fullmatch(key):
            continue
        try:
            value = float(parameters[key])
        except ValueError:
            continue
        if limits[0] <= value <= limits[1]:
            return value
    return None


def _degrees(value: float) -> str:
    return f"{value:.0f} degrees"
