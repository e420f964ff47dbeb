"""The extensions that an integrator would write, each in a file of its own, run as they stand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ambler.core.devices import DeviceState
from ambler.core.errors import DeviceError
from ambler.core.messages import PowerSupply
from examples import (
    carrot_planner,
    keep_out_zones,
    more_sensors,
    outside_client,
    own_driver,
    own_mission,
    second_robot,
    simulate,
)

FOLDER = Path(__file__).parents[2] / "examples"


def test_a_simulated_robot_explores(tmp_path: Path) -> None:
    fields = simulate.main(tmp_path / "run")
    assert (fields["ended"], fields["collisions"]) == ("finished", 0)
    assert fields["coverage_ratio"] > 0.99


def test_a_local_planner_drives_to_the_goal(tmp_path: Path) -> None:
    fields = carrot_planner.main(tmp_path / "run")
    assert (fields["ended"], fields["collisions"]) == ("succeeded", 0)
    assert fields["worst_goal_error_m"] < 0.25
    assert fields["path_length_m"] > 2.5


def test_two_more_sensors_are_told_on_topics_of_their_own(tmp_path: Path) -> None:
    fields = more_sensors.main(tmp_path / "run")
    assert (fields["ended"], fields["collisions"]) == ("succeeded", 0)
    seconds = fields["sim_seconds"]
    assert fields["/imu"] == pytest.approx(100.0 * seconds, abs=5)
    assert fields["/imu/rear_imu"] == pytest.approx(200.0 * seconds, abs=10)
    assert fields["/camera/image"] == pytest.approx(5.0 * 3.0, abs=2), "for as long as they were asked for"


def test_a_driver_takes_the_place_of_a_simulated_device(tmp_path: Path) -> None:
    values = {"capacity": "73", "voltage_now": "51200000", "current_now": "1500000", "status": "Discharging"}
    for name, text in values.items():
        (tmp_path / name).write_text(text + "\n")
    fields = own_driver.main(tmp_path / "run", tmp_path)
    assert fields["ended"] == "succeeded"
    assert fields["messages"] >= 3
    assert (fields["voltage"], fields["share"]) == pytest.approx((51.2, 0.73), rel=1e-6)
    assert fields["supply"] is PowerSupply.DISCHARGING


def test_a_driver_without_its_device_says_so(tmp_path: Path) -> None:
    driver = own_driver.LinuxBattery(tmp_path)
    with pytest.raises(DeviceError, match="is no battery"):
        driver.open()
    (tmp_path / "capacity").write_text("50")
    driver.open()
    assert driver.read(0) == ()
    assert driver.health().state is DeviceState.FAILED


def test_a_keep_out_zone_is_driven_around(tmp_path: Path) -> None:
    around = keep_out_zones.main(tmp_path / "around")
    straight = keep_out_zones.main(tmp_path / "straight", ())
    for fields in (around, straight):
        assert (fields["ended"], fields["collisions"]) == ("succeeded", 0)
    assert straight["path_length_m"] < 3.05
    assert around["path_length_m"] > 3.15
    inside = np.array([[9.0, 9.0], [9.5, 9.0], [9.5, 9.5]])
    assert keep_out_zones.main(tmp_path / "far", (inside,))["path_length_m"] < 3.05


def test_a_mission_goes_round(tmp_path: Path) -> None:
    fields = own_mission.main(tmp_path / "run")
    assert (fields["ended"], fields["corners"], fields["collisions"]) == ("succeeded", 4, 0)
    assert 4.0 < fields["path_length_m"] < 8.0


def test_a_client_from_outside_plans_pauses_and_drives(tmp_path: Path) -> None:
    said = outside_client.main(tmp_path / "run")
    assert (said["paused"], said["armed"], said["outcome"]) == (True, True, "SUCCEEDED")
    assert 2.85 < said["path_length_m"] < 4.5


def test_a_second_robot_explores_beside_the_first(tmp_path: Path) -> None:
    results = second_robot.main(tmp_path / "run")
    assert set(results) == {"first", "second"}
    for fields in results.values():
        assert (fields["ended"], fields["collisions"]) == ("finished", 0)
        assert fields["coverage_ratio"] >= 0.98
        assert fields["ate_rms_m"] <= 0.05


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_says_how_to_run_it(path: Path) -> None:
    assert f"python examples/{path.name}" in path.read_text(encoding="utf-8")
