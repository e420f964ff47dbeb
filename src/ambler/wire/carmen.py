"""Reader of CARMEN logs: FLASER, RLASER, ROBOTLASER1.., RAWLASER1.., PARAM and ODOM lines of plain, gzip or bzip2 files.

`FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_stamp host logger_stamp`; beams go right to left.
`ROBOTLASER1 type start fov step max_range accuracy remission_mode n r1..rn m s1..sm laser_pose(3) robot_pose(3) tv rv
forward side turn_axis ipc_stamp host logger_stamp`. `RAWLASER1` is the same up to s1..sm, then ipc_stamp host logger_stamp. Some logs lack
the logger's stamp, or the host, too. A few damaged lines are left out and told; more are reported with the line or byte where they show.
"""

from __future__ import annotations

import bz2
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.wire.carmen_damage import Damage, LineKind, OtherMessages, damage_notes, refuse_hopeless
from ambler.wire.carmen_scanners import BeamLayout, layout_of, told_range

_NAME = re.compile(rb"[A-Za-z][A-Za-z0-9_-]*")
_CHUNK = 1 << 20
_MAX_BEAMS = 20000
_OLD_LASERS = ("FLASER", "RLASER")
_POSED_LASER = re.compile(rb"[FR]LASER|ROBOTLASER\d+")
_RAW_LASER = re.compile(rb"RAWLASER\d+")


@dataclass(frozen=True, slots=True, eq=False)
class LaserLine:
    """One laser line: `ranges` float32 (N,) metres (NaN for what is negative or no number), beam i at angle_min + i * angle_increment in
    the laser frame, poses as logged (`odom_from_laser` may hold a corrected pose in some logs; both None in RAWLASER lines), `stamp` the ipc
    stamp in seconds, `max_range` of the device or inf."""

    name: str
    line: int
    stamp: float
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    max_range: float
    odom_from_laser: SE2 | None
    odom_from_base: SE2 | None


@dataclass(frozen=True, slots=True)
class OdometryLine:
    """One ODOM line."""

    line: int
    stamp: float
    odom_from_base: SE2


@dataclass(frozen=True, slots=True)
class CarmenLog:
    """A log in file order, and its parameters; `cut_line` is the number of its last line when that was cut off, and is left out. Either
    all lasers carry poses or none does. `notes` say what is uncertain or was left out."""

    lasers: tuple[LaserLine, ...]
    odometry: tuple[OdometryLine, ...]
    parameters: dict[str, str]
    cut_line: int | None = None
    notes: tuple[str, ...] = ()


def _chunks(path: Path) -> Iterator[bytes]:
    """Decompress by the file's magic, not its name; raises BadInputError naming the byte where the stream breaks."""
    done = 0
    try:
        with path.open("rb") as raw:
            magic = raw.read(3)
        opener = bz2.open if magic == b"BZh" else gzip.open if magic[:2] == b"\x1f\x8b" else open
        with opener(path, "rb") as stream:
            while chunk := stream.read(_CHUNK):
                done += len(chunk)
                yield chunk
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise BadInputError(
            f"{path}: compressed stream is damaged or cut off after byte {done} of text: {error}"
        ) from error
    except OSError as error:
        where = f" after byte {done} of text" if error.errno is None else ""
        raise BadInputError(f"{path}: cannot be read{where}: {error.strerror or error}") from error


def _lines(path: Path) -> Iterator[tuple[int, bytes, bool]]:
    """Yield number and text of each line, and whether its end is there."""
    rest = b""
    number = 0
    for chunk in _chunks(path):
        parts = (rest + chunk).split(b"\n")
        rest = parts.pop()
        if len(rest) > _CHUNK:
            raise BadInputError(
                f"{path}: line {number + len(parts) + 1} is longer than a megabyte; this is no CARMEN log"
            )
        for part in parts:
            number += 1
            yield number, part, True
    if rest:
        yield number + 1, rest, False


def _floats(fields: list[bytes]) -> list[float]:
    return [float(f) for f in fields]


def _pose(x: float, y: float, theta: float) -> SE2:
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(theta)):
        raise ValueError("a pose is not finite")
    return SE2(x, y, math.remainder(theta, 2.0 * math.pi))


def _count(field: bytes, available: int) -> int:
    n = int(field)
    if not 0 <= n <= min(available, _MAX_BEAMS):
        raise ValueError(f"announces {n} readings and has {available} fields left")
    return n


def _stamp(field: bytes) -> float:
    value = float(field)
    if not 0.0 <= value < 1e11:
        raise ValueError(f"stamp {value} is impossible")
    return value


def _ranges(fields: list[bytes]) -> NDArray[np.float32]:
    out = np.array(_floats(fields), np.float32)
    is_range = out >= 0.0
    if not is_range.all():
        out[~is_range] = np.nan
    return out


def _end(fields: list[bytes], stamp_at: int, what: str) -> int:
    """Return how many fields stand behind the stamp: 2 (host, logger stamp), 1 (host), or 0; raises ValueError if they are no such."""
    end = len(fields) - stamp_at - 1
    if not 0 <= end <= 2:
        raise ValueError(f"{what} {stamp_at + 3} fields, but has {len(fields)}")
    if end == 2:
        float(fields[-1])
    elif end == 1 and _is_number(fields[-1]):
        raise ValueError(f"{what} {stamp_at + 3} fields, but has {len(fields)}, and the last is no host")
    return end


def _is_number(field: bytes) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _laser(name: str, number: int, fields: list[bytes]) -> tuple[LaserLine, int]:
    """Read a laser line; returns how many fields stand behind its stamp, too."""
    return (_old_laser if name in _OLD_LASERS else _new_laser)(name, number, fields)


def _old_laser(name: str, number: int, fields: list[bytes]) -> tuple[LaserLine, int]:
    n = _count(fields[1], len(fields) - 2)
    end = _end(fields, n + 8, f"announces {n} readings, so it needs")
    if n == 0:
        raise ValueError("has no readings")
    v = _floats(fields[n + 2 : n + 8])
    line = LaserLine(
        name,
        number,
        _stamp(fields[n + 8]),
        _ranges(fields[2 : n + 2]),
        # the angles are found when all parameters are known
        math.nan,
        math.nan,
        math.inf,
        _pose(v[0], v[1], v[2]),
        _pose(v[3], v[4], v[5]),
    )
    return line, end


def _new_laser(name: str, number: int, fields: list[bytes]) -> tuple[LaserLine, int]:
    """Read a ROBOTLASER or RAWLASER line; the latter ends after the remissions."""
    start, _fov, step, max_range = _floats(fields[2:6])
    n = _count(fields[8], len(fields) - 9)
    if n == 0:
        raise ValueError("has no readings")
    m = _count(fields[9 + n], len(fields) - 10 - n)
    tail = fields[10 + n + m :]
    has_poses = name.startswith("ROBOT")
    values = 11 if has_poses else 0
    end = _end(fields, 10 + n + m + values, f"announces {n} readings and {m} remissions, so it needs")
    if not (abs(start) <= 2 * math.pi and 0.0 < abs(step) < 1.0):
        raise ValueError("has an impossible start angle or step")
    v = _floats(tail[:values])
    line = LaserLine(
        name,
        number,
        _stamp(tail[values]),
        _ranges(fields[9 : 9 + n]),
        start,
        step,
        max_range if max_range > 0.0 else math.inf,
        _pose(v[0], v[1], v[2]) if has_poses else None,
        _pose(v[3], v[4], v[5]) if has_poses else None,
    )
    return line, end


def _odometry(name: str, number: int, fields: list[bytes]) -> tuple[OdometryLine, int]:
    end = _end(fields, 7, "needs")
    v = _floats(fields[1:7])
    return OdometryLine(number, _stamp(fields[7]), _pose(v[0], v[1], v[2])), end


class _Content:
    """What has been read of a log."""

    def __init__(self) -> None:
        self.lasers, self.raw_lasers, self.odometry = LineKind(_laser), LineKind(_laser), LineKind(_odometry)
        self.parameters: dict[str, str] = {}
        self.others = OtherMessages()
        self.garbage: list[Damage] = []

    def add(self, number: int, fields: list[bytes], *, is_whole: bool) -> bool:
        """Read a line; returns whether it is right. A damaged one counts, unless it is the end of a file of scans, which was cut off."""
        name = fields[0]
        damage = self.garbage
        try:
            if _POSED_LASER.fullmatch(name):
                damage = self.lasers.damage
                self.lasers.add(number, fields, is_whole=is_whole)
            elif _RAW_LASER.fullmatch(name):
                damage = self.raw_lasers.damage
                self.raw_lasers.add(number, fields, is_whole=is_whole)
            elif name == b"ODOM":
                damage = self.odometry.damage
                self.odometry.add(number, fields, is_whole=is_whole)
            elif name == b"PARAM":
                if len(fields) >= 3:
                    self.parameters[fields[1].decode(errors="replace")] = fields[2].decode(errors="replace")
            elif _NAME.fullmatch(name):
                self.others.add(number, name[:20].decode())
            else:
                raise ValueError(f"begins with {name[:20]!r}, which is no CARMEN message")
        except (ValueError, IndexError) as error:
            if is_whole or not (self.lasers or self.raw_lasers):
                damage.append(Damage(number, name.decode("ascii", "replace")[:20], str(error)))
            return False
        return True


def load_carmen(path: Path) -> CarmenLog:
    """Read a log; what is left out is told: a few damaged lines, a last line that was cut off, RAWLASER lines beside lines that carry
    poses, and messages of other kinds. ODOM lines need be right only where no laser line carries a pose.

    Raises BadInputError naming the line or byte of the first damage where there is more, or saying that there is no laser line.
    """
    content = _Content()
    number, is_whole, is_right = 0, True, True
    for number, line, is_whole in _lines(path):
        fields = line.split()
        is_right = not fields or fields[0].startswith(b"#") or content.add(number, fields, is_whole=is_whole)
        if not is_right:
            refuse_hopeless(path, content.garbage, len(content.lasers) + len(content.raw_lasers))
    posed, raw, track = content.lasers.finish(), content.raw_lasers.finish(), content.odometry.finish()
    unused_damage = content.raw_lasers.damage
    damage = content.garbage + content.lasers.damage + ([] if posed else unused_damage + content.odometry.damage)
    notes = damage_notes(path, damage, len(posed) or len(raw))
    if not posed and not raw:
        raise BadInputError(
            f"{path}: no laser line (FLASER, RLASER, ROBOTLASER1, RAWLASER1) in {number} lines; this is no CARMEN laser log"
        )
    notes.extend(content.others.notes())
    is_unknown = np.isnan(np.concatenate([line.ranges for line in posed or raw]))
    unknown = int(np.count_nonzero(is_unknown))
    if unknown == len(is_unknown):
        raise BadInputError(f"{path}: all readings are negative or no number")
    if unknown:
        notes.append(f"readings that are negative or no number: {unknown}; they are neither walls nor free space")
    if posed and (raw or unused_damage):
        unused = len(raw) + len(unused_damage)
        notes.append(f"left out: {unused} RAWLASER lines, which carry no pose, beside {len(posed)} that do")
    described = tuple(_described(posed or raw, content.parameters, notes))
    return CarmenLog(described, track, content.parameters, None if is_whole or is_right else number, tuple(notes))


def _described(lasers: tuple[LaserLine, ...], parameters: dict[str, str], notes: list[str]) -> Iterator[LaserLine]:
    """Yield the lines with the angles and the range that old ones do not carry; what is uncertain goes into `notes`."""
    layouts: dict[tuple[str, int], BeamLayout] = {}
    told = {name: told_range(name, parameters) for name in {line.name for line in lasers}}
    for line in lasers:
        reach = line.max_range if math.isfinite(line.max_range) else told[line.name]
        if line.name not in _OLD_LASERS:
            yield line if reach == line.max_range else replace(line, max_range=reach)
            continue
        key = line.name, len(line.ranges)
        if key not in layouts:
            layouts[key] = layout_of(*key, parameters)
            notes.extend([layouts[key].doubt] if layouts[key].doubt else [])
        layout = layouts[key]
        yield replace(line, angle_min=layout.angle_min, angle_increment=layout.angle_increment, max_range=reach)
