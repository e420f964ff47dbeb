"""Stations in files: what is written is read again, laid in the map; what is broken is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError, NotWrittenError
from ambler.core.se3 import SE3
from ambler.wire.cloud_files import read_cloud
from ambler.wire.station_files import StationCloud, load_stations, save_stations


def stations() -> list[StationCloud]:
    rng = np.random.default_rng(3)
    out = []
    for k in range(3):
        pose = SE3.from_rpy((10.0 * k, -3.0, 0.5), 0.05, -0.02, 0.7 * k)
        points, intensity = rng.normal(0.0, 5.0, (100 + k, 3)), rng.uniform(0.0, 200.0, 100 + k)
        told = (k + 1, 17_000_000_001 * (k + 1), k % 2, pose, 5.0 - k, 50, 31.5)
        out.append(StationCloud(*told, points.astype(np.float32), intensity.astype(np.float32)))
    return out


def test_stations_come_back_and_their_cloud_lies_in_the_map(tmp_path: Path) -> None:
    wanted = stations()
    save_stations(tmp_path / "map", wanted, 0.02)
    found = load_stations(tmp_path / "map")
    for a, b in zip(wanted, found, strict=True):
        assert (a.number, a.stamp_ns, a.level, a.seconds, a.scans, a.density) == (
            *(b.number, b.stamp_ns, b.level, b.seconds, b.scans, b.density),
        )
        assert b.map_from_base == a.map_from_base
        assert b.points == pytest.approx(a.points, abs=1e-4)
        assert (b.intensity == a.intensity).all()
    cloud = read_cloud(tmp_path / "map.stations.pcd")
    assert len(cloud) == 100 + 101 + 102
    second = wanted[1].map_from_base.transform(wanted[1].points)
    assert np.column_stack([cloud[axis] for axis in "xyz"])[100:201] == pytest.approx(second, abs=1e-4)
    table = json.loads((tmp_path / "map.stations.json").read_text())
    assert table["frame"] == "map"
    assert [row["first_point"] for row in table["stations"]] == [0, 100, 201]


def test_no_station_is_an_empty_table(tmp_path: Path) -> None:
    save_stations(tmp_path / "map", [], 0.02)
    assert load_stations(tmp_path / "map") == []


def test_the_table_comes_last(tmp_path: Path) -> None:
    (tmp_path / "map.stations.pcd").mkdir()
    with pytest.raises(NotWrittenError, match="stations"):
        save_stations(tmp_path / "map", stations(), 0.02)
    assert not (tmp_path / "map.stations.json").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "no table of stations"),
        ('{"points": 7, "stations": []}', "tells of 7 points, its cloud has 303"),
        ('{"points": 303, "stations": [{"number": 1}]}', "no table of stations"),
        ('{"points": 303, "stations": [{"map_from_base": [1, 2]}]}', "seven finite numbers"),
    ],
)
def test_broken_tables_are_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    save_stations(tmp_path / "map", stations(), 0.02)
    path = tmp_path / "map.stations.json"
    path.write_text(text)
    with pytest.raises(BadInputError, match=f"map.stations.json.*{words}"):
        load_stations(tmp_path / "map")
