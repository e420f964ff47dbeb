"""`ambler world generate` writes what it drew, and says in one line what it cannot."""

import json
from pathlib import Path

import cv2
import pytest

from ambler.cli.main import main
from ambler.sim.world_file import load_world


def test_a_drawn_place_is_written_with_its_picture_and_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world, picture, result = tmp_path / "flat.yaml", tmp_path / "flat.png", tmp_path / "flat.json"
    words = ["--out", str(world), "--picture", str(picture), "--json", str(result)]
    assert main(["world", "generate", "flat", "--seed", "5", *words]) == 0
    told = json.loads(result.read_text())
    assert (told["kind"], told["seed"]) == ("flat", 5)
    assert f"{told['reachable_m2']:.0f} m²" in capsys.readouterr().out
    assert load_world(world).solids == load_world("flat-5").solids
    assert cv2.imread(str(picture)).shape[0] > 200
    assert "ambler world generate flat --seed 5" in world.read_text().splitlines()[0]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["castle"], "no kind of place 'castle'; there are office, flat"),
        (["flat", "--seed", "-1"], "seed -1"),
        (["flat", "--out", "plan.txt"], "a world file ends in .yaml"),
        (["flat", "--picture", "/proc/nothing/plan.png"], "cannot be written"),
    ],
)
def test_mistakes_get_one_line(words: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["world", "generate", *words]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert len(error.strip().splitlines()) == 1
