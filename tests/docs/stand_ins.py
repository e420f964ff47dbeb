"""The files that the documents' commands name: the small recording as the latest run, and logs of a simulated drive."""

import bz2
import gzip
import re
import shutil
from itertools import islice
from pathlib import Path

import numpy as np

from tests.docs.commands import ROOT
from tests.localization import rooms

BEAMS = 180


def make(folder: Path) -> None:
    """Put every file there under the name that the documents use."""
    (folder / "examples").symlink_to(ROOT / "examples")
    shutil.copytree(ROOT / "examples" / "lab_empty", folder / "runs" / "LATEST")
    log, relations = _drive()
    (folder / "log.clf.gz").write_bytes(gzip.compress(log.encode()))
    (folder / "log.clf.bz2").write_bytes(bz2.compress(log.encode()))
    (folder / "log.relations").write_text(relations)
    profile = first_yaml("configuration")
    (folder / "slow.yaml").write_text(profile)
    (folder / "studies" / "paths").mkdir(parents=True)
    (folder / "studies" / "paths" / "best.yaml").write_text(profile)
    plan = (ROOT / "examples" / "lab_empty" / "map.yaml").read_text(encoding="utf-8")
    (folder / "my_floor_plan.yaml").write_text(plan)
    shutil.copy(ROOT / "examples" / "lab_empty" / "map.pgm", folder / "map.pgm")


def first_yaml(page: str) -> str:
    """Return the first block of YAML of a page."""
    found = re.search(r"```yaml\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


def _drive() -> tuple[str, str]:
    """Return five seconds through the office as a CARMEN log, and where they led as a relation."""
    room, lines = rooms.office(), []
    angles = np.radians(np.arange(BEAMS) * 180.0 / BEAMS - 90.0)
    steps = list(islice(rooms.drive(room, rooms.ROUTES["office"], np.random.default_rng(4), beams=4), 50))
    for step in steps:
        ranges = " ".join(f"{r:.2f}" for r in np.minimum(room.cast(step.truth, angles), 81.83))
        pose = f"{step.odom_from_base.x:.4f} {step.odom_from_base.y:.4f} {step.odom_from_base.yaw:.5f}"
        stamp = 1.0 + 1e-9 * (step.stamp_ns - steps[0].stamp_ns)
        lines.append(f"FLASER {BEAMS} {ranges} {pose} {pose} {stamp:.6f} robot {stamp:.6f}\n")
    moved = steps[0].truth.inverse() @ steps[-1].truth
    relation = f"1.000000 {stamp:.6f} {moved.x:.5f} {moved.y:.5f} 0 0 0 {moved.yaw:.5f}\n"
    return "".join(lines), relation
