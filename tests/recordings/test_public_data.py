"""The folder of public recordings: only the environment variable says where it is."""

from pathlib import Path

import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.recordings.public_data import VARIABLE, public_data


def test_the_variable_names_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "radish").mkdir()
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert public_data("radish") == tmp_path / "radish"
    with pytest.raises(BadInputError, match=r"maps: not in the folder of AMBLER_DATA \(docs/datasets.md\)"):
        public_data("maps")


@pytest.mark.parametrize("value", [None, ""])
def test_without_it_the_page_is_named(value: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    if value is not None:
        monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(BadInputError, match=r"set AMBLER_DATA .* \(docs/datasets.md\)"):
        public_data("radish")


@pytest.mark.parametrize("bench", ["posegraph", "exploration"])
def test_a_bench_without_data_is_one_clear_line(
    bench: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert main(["bench", bench]) == 2
    assert capsys.readouterr().err == (
        f"ambler: {bench} is public data: set AMBLER_DATA to the folder that holds it (docs/datasets.md)\n"
    )
