"""A folder of clouds as a recording: PCD, PLY or BIN files with `times.txt`, KITTI's folders too (`kitti_drive`), and perhaps `imu.txt` or `imu.csv`.

Inertial files have seven columns: times (s, ms, µs or ns), three rates (rad/s) and three forces, or the forces first; a header line (t, wx, wy, wz, ax, ay,
az in any order) says which, else the three that are longer on average are the forces.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu, PointCloud
from ambler.core.se3 import SE3
from ambler.recordings.cloud_parts import MANY, PartJoiner, mean_spacing, scans_of_parts
from ambler.recordings.cloud_scan import CloudScan, returns_in_order
from ambler.recordings.kitti_drive import read_mount, read_oxts, read_sweeps, times_in_sweep
from ambler.wire.cloud_columns import EPOCH_NS, INTENSITY, RING, UNITS_NS, column, point_times, times_within
from ambler.wire.cloud_files import is_text, kind_of, read_cloud

F64 = NDArray[np.float64]
TIMES = ("times.txt", "timestamps.txt", "times.csv")
LATEST_NS = 9 * 10**18
SINCE_NS, HOUR_NS = 10**18, 3600 * 10**9  # times from 2001 on are dates, unless clouds were hours apart then
SPACING_NS = (4 * 10**6, 20 * 10**9)  # of clouds: 250 a second to three a minute
IMU_SPACING_NS = (10**5, 5 * 10**8)  # of inertial measurements: ten thousand a second to two
IMUS = ("imu.txt", "imu.csv")
COLUMNS = ("t", "wx", "wy", "wz", "ax", "ay", "az")


@dataclass(frozen=True, slots=True)
class CloudFolder:
    """What `open_cloud_folder` found; the same to its users as a `CloudRecording`."""

    path: Path
    files: tuple[Path, ...]
    stamps_ns: tuple[int, ...]
    imu: tuple[Imu, ...]
    lidar_from_imu: SE3 | None
    base_from_lidar: SE3 | None
    notes: tuple[str, ...]
    sweeps: tuple[float, ...] = ()
    """Seconds that each sweep took from its stamp on, where points have no times of their own but the folder tells that."""

    @property
    def clouds(self) -> int:
        """How many scans there will be, about, where they are joined of parts."""
        return scans_of_parts(len(self.files), 0.0, self.spacing)[0]

    @property
    def spacing(self) -> float | None:
        """Seconds between two clouds; None: there is one."""
        return mean_spacing(list(self.stamps_ns[: MANY + 1]))

    @property
    def imu_topic(self) -> str | None:
        return "imu" if self.imu else None

    def scans(self, lidar_clock: float = 0.0) -> Iterator[CloudScan]:
        """Yield the clouds with the inertial measurements up to their end and one more; their stamps lag `lidar_clock` s behind those of the measurements. Raises BadInputError for a file that cannot be read."""
        at = 0
        for cloud in self._joined():
            scan = CloudScan(cloud, (), ())
            begin, taken_ns = at, scan.end_ns + round(lidar_clock * 1e9)
            while at < len(self.imu) and (at == begin or self.imu[at - 1].stamp_ns < taken_ns):
                at += 1
            yield CloudScan(cloud, self.imu[begin:at], ())

    def _joined(self) -> Iterator[PointCloud]:
        """Yield whole clouds, and scans of parts."""
        joiner = PartJoiner(self.spacing)
        for cloud in self._read():
            yield from joiner.add(cloud)
        yield from joiner.end()

    def _read(self) -> Iterator[PointCloud]:
        """Yield the returns of every file."""
        spacing = self.spacing
        for k, (file, stamp_ns) in enumerate(zip(self.files, self.stamps_ns, strict=True)):
            table = read_cloud(file)
            points = np.stack([np.asarray(table[axis], np.float32) for axis in "xyz"], axis=1)
            times = times_within(point_times(table, stamp_ns), spacing)
            if self.sweeps and not times.any():
                times = times_in_sweep(points, self.sweeps[k])
            cloud = PointCloud(
                stamp_ns,
                "lidar",
                points,
                column(table, INTENSITY, np.dtype(np.float32)),
                times,
                column(table, RING, np.dtype(np.uint16)),
            )
            yield returns_in_order(cloud)


def open_cloud_folder(path: Path, lidar_from_imu: SE3 | None = None) -> CloudFolder:
    """Look into a folder; raises BadInputError that names what is missing."""
    if not path.is_dir():
        raise BadInputError(f"{path}: no such folder")
    folders = (path / "velodyne_points" / "data", path / "velodyne", path)
    folder, files = next(((f, files) for f in folders if (files := _clouds_of(f))), (path, []))
    if not files:
        raise BadInputError(f"{path}: neither a bag nor clouds (.pcd, .ply, .bin, also .gz) are in this folder")
    stamps, origin = _stamps(path, folder, files)
    sweeps = read_sweeps(folder.parent, _listed)
    if sweeps is not None and len(sweeps) == len(files):
        stamps, origin = sweeps[:, 0], "the sweeps' begins and ends"
    else:
        sweeps = None
    if (np.diff(stamps) <= 0).any():
        k = int(np.argmax(np.diff(stamps) <= 0))
        raise BadInputError(f"{path}: time goes backwards or stands still from {files[k].name} to {files[k + 1].name}")
    source = next((f for name in IMUS if (f := path / name).exists()), None)
    imu, told = ((), "none") if source is None else (found := _read_imu(source), f"{len(found)} of {source.name}")
    if source is None and (path / "oxts" / "data").is_dir():
        imu, told = read_oxts(path / "oxts", _listed)
    notes = (
        f"clouds: {len(files)} files {files[0].name} to {files[-1].name}, times from {origin}",
        *scans_of_parts(len(files), 0.0, mean_spacing(stamps[: MANY + 1].tolist()))[1],
        f"inertial measurements: {told}",
    )
    seconds = () if sweeps is None else tuple((np.diff(sweeps, axis=1)[:, 0] * 1e-9).tolist())
    mount = lidar_from_imu if lidar_from_imu is not None else read_mount(path)
    return CloudFolder(path, tuple(files), tuple(stamps.tolist()), imu, mount, None, notes, seconds)


def _clouds_of(folder: Path) -> list[Path]:
    """Return the clouds in a folder, in their order; in that of a raw drive of KITTI's, which holds nothing else, text too."""
    if not folder.is_dir():
        return []
    there = sorted(folder.iterdir(), key=_natural)
    clouds = [f for f in there if kind_of(f) is not None]
    is_drive = folder.parts[-2:] == ("velodyne_points", "data")
    return clouds if clouds or not is_drive else [f for f in there if is_text(f)]


def _natural(path: Path) -> tuple[object, ...]:
    """Numbers in names count as numbers: full2 before full10."""
    return tuple(int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name))


def _stamps(path: Path, folder: Path, files: list[Path]) -> tuple[NDArray[np.int64], str]:
    """Return the clouds' stamps (ns) and where they come from: a file of times, or the names."""
    places = [f / name for f in (path, folder, folder.parent) for name in TIMES]
    source = next((f for f in places if f.exists()), None)
    if source is not None:
        stamps = _listed(source)
        if len(stamps) != len(files):
            raise BadInputError(f"{source}: {len(stamps)} times for {len(files)} clouds")
        return stamps, source.name
    names = [
        re.fullmatch(r"\D*(\d+\.\d+|\d{10}_\d{1,9}|\d{10,19})\D*", f.name.removesuffix(".gz").rsplit(".", 1)[0])
        for f in files
    ]
    if all(names):
        words = [match[1] for match in names if match is not None]
        stamps = np.array([_ns_of(word) for word in words], np.int64)
        if stamps.min() > EPOCH_NS:  # else they are numbers of files
            return stamps, "the names"
    raise BadInputError(f"{path}: no times for the clouds ({', '.join(TIMES)}, one number of seconds a line)")


def _listed(source: Path) -> NDArray[np.int64]:
    """Return the times (ns) of a file with one a line: s, ms, µs or ns, after the number of the cloud or before nanoseconds perhaps, or dates as KITTI has them. Raises BadInputError."""
    try:
        lines = [line.strip() for line in source.read_text(encoding="utf-8", errors="replace").splitlines()]
        lines = [line for line in lines if line and (line[0] in "0123456789-+." or line[:3].lower() in ("nan", "inf"))]
        if lines and re.match(r"\d+-\d+-\d+[T ]", lines[0]):
            return np.array([line.replace(" ", "T") for line in lines], "datetime64[ns]").astype(np.int64)
        rows = [re.split(r"[,;\s]+", line) for line in lines]
        times = [Decimal(row[0]) for row in rows]
        if not all(time.is_finite() for time in times):
            raise BadInputError(f"{source}: a time is not finite")
        seconds = [row[1] if len(row) > 1 else "" for row in rows]
        if times[:1] in ([0], [1]) and all(b - a == 1 for a, b in pairwise(times)) and all(map(_is_number, seconds)):
            times = [Decimal(word) for word in seconds]
        elif all(
            len(row[0]) == 10 and word.isdecimal() and len(word) < 10 for row, word in zip(rows, seconds, strict=True)
        ):
            times = [time + Decimal(word).scaleb(-9) for time, word in zip(times, seconds, strict=True)]
    except (ValueError, ArithmeticError, OSError) as error:
        raise BadInputError(f"{source}: is no list of seconds or dates: {error}") from error
    unit_ns = _unit_of(times)
    if unit_ns == 0:
        raise BadInputError(f"{source}: {max(times):g} is no time in s, ms, µs or ns")
    return np.array([round(time * unit_ns) for time in times], np.int64)


def _unit_of(times: list[Decimal], spacing_ns: tuple[int, int] = SPACING_NS) -> int:
    """Return the unit (ns) of times: the one in which they are of this age of clocks, else the one in which they follow each other as what they are of does, else the largest that any clock
    counts; 0 if there is none."""
    latest = max(map(abs, times), default=Decimal(0))
    usable = [unit for unit in UNITS_NS if latest * unit <= LATEST_NS]
    if not usable:
        return 0
    spacing = Decimal(float(np.median(np.diff(np.array(times, np.float64))))) if len(times) > 1 else Decimal(0)
    if latest * usable[0] >= SINCE_NS and spacing * usable[0] <= HOUR_NS:
        return usable[0]
    low, high = spacing_ns
    return next((unit for unit in usable if low <= spacing * unit <= high), usable[0])


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[-+]?\d*\.?\d+(e[-+]?\d+)?", word.lower()) is not None


def _ns_of(word: str) -> int:
    """Return a time since the epoch in a file's name: seconds with decimals, or with nanoseconds behind a line, or whole s, ms, µs or ns by the number of digits."""
    whole, line, ns = word.partition("_")
    if line:
        return int(whole) * 10**9 + int(ns)
    seconds, point, decimals = word.partition(".")
    if point or len(seconds) == 10:
        return int(seconds) * 10**9 + int(decimals[:9].ljust(9, "0"))
    return int(seconds) * int(10.0 ** (19 - len(seconds)))


def _read_imu(path: Path) -> tuple[Imu, ...]:
    """Read inertial measurements; raises BadInputError."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from error
    head = re.split(r"[,\s]+", lines[0].strip().lstrip("#").strip()) if lines else []
    named = head if sorted(head) == sorted(COLUMNS) else None
    rows = [re.split(r"[,\s]+", line.strip()) for line in lines if line.strip() and line.strip()[0] in "0123456789-+."]
    try:
        table = np.array(rows, np.float64)
    except ValueError as error:
        raise BadInputError(f"{path}: rows must have seven numbers: {error}") from error
    if table.ndim != 2 or table.shape[1] != 7:
        raise BadInputError(f"{path}: rows must have seven numbers (t wx wy wz ax ay az)")
    if named is not None:
        table = table[:, [named.index(name) for name in COLUMNS]]
    elif _mean_length(table[:, 1:4]) > _mean_length(table[:, 4:7]):
        table = table[:, [0, 4, 5, 6, 1, 2, 3]]
    if not np.isfinite(table[:, 0]).all():
        raise BadInputError(f"{path}: a time is not finite")
    at = 0 if named is None else named.index("t")
    times = [Decimal(row[at]) for row in rows]
    unit_ns = _unit_of(times, IMU_SPACING_NS)
    if unit_ns == 0:
        raise BadInputError(f"{path}: {max(times, key=abs):g} is no time in s, ms, µs or ns")
    stamps = [round(time * unit_ns) for time in times]
    return tuple(
        Imu(stamp, "imu", (r[1], r[2], r[3]), (r[4], r[5], r[6]))
        for stamp, r in zip(stamps, table.tolist(), strict=True)
    )


def _mean_length(vectors: F64) -> float:
    return float(np.nanmean(np.linalg.norm(vectors, axis=1)))
