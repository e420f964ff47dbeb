"""The examples of docs/simulation.md are run as they stand."""

import re
from pathlib import Path

import pytest

from ambler.sim.faults import FaultKind
from ambler.sim.robots import robot_named
from ambler.sim.route import load_route
from ambler.sim.world_file import load_world

PAGE = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text()


def example(language: str, number: int = 0) -> str:
    return str(re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)[number])


@pytest.mark.parametrize(("number", "said"), [(0, "2 205000000"), (1, "2 20 ")])
def test_the_python_examples_run(number: int, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(example("python", number), "simulation.md", "exec"), {})
    assert capsys.readouterr().out.startswith(said)


def test_the_world_example_loads(tmp_path: Path) -> None:
    path = tmp_path / "example.yaml"
    path.write_text(example("yaml"))
    names = [s.name for s in load_world(path).solids]
    assert {"desk", "column", "pillar", "wall_0", "rack_post"} <= set(names)
    assert len(load_world(path).people) == 1


def test_the_urdf_example_loads(tmp_path: Path) -> None:
    path = tmp_path / "cart.urdf"
    path.write_text(example("xml"))
    robot = robot_named(str(path))
    assert (robot.model.name, robot.track, robot.mass) == ("cart", 0.32, 20.0)
    assert robot.model.sensor("laser_link").base_from_sensor.translation == (0.1, 0.0, 0.4)


def test_every_fault_of_the_page_exists() -> None:
    table = PAGE[PAGE.index("## Faults") :]
    named = re.findall(r"^\| `(\w+)", table, re.MULTILINE)
    assert sorted(named) == sorted(k.value for k in FaultKind)


def test_the_route_example_of_the_drives_loads(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "driving.md").read_text()
    path = tmp_path / "route.yaml"
    path.write_text(str(re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)[0]))
    route = load_route(path, load_world("campus"))
    assert (len(route.points), route.speed) == (3, 0.8)
