"""The list of planted faults fits the source as it is."""

from __future__ import annotations

import re

import pytest

from tests.mutation.__main__ import KERNELS, reached_by
from tests.mutation.faults import FAULTS
from tests.mutation.planted import PACKAGE, REPOSITORY, PlantedFault


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault_can_be_planted_and_its_tests_exist(fault: PlantedFault) -> None:
    path = REPOSITORY / "src" / PACKAGE / fault.file
    source = path.read_text(encoding="utf-8")
    planted = fault.planted(source)
    assert planted != source
    compile(planted, str(path), "exec")
    assert fault.tests
    for test in fault.tests:
        file, _, name = test.partition("::")
        text = (REPOSITORY / file).read_text(encoding="utf-8")
        assert not name or re.search(rf"^def {re.escape(name.split('[')[0])}\(", text, re.MULTILINE), test


def test_there_are_enough_faults_and_no_two_are_one() -> None:
    assert len(FAULTS) >= 60
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    assert len({(fault.file, fault.old, fault.new) for fault in FAULTS}) == len(FAULTS)


def test_a_fault_needs_its_text_exactly_once() -> None:
    fault = PlantedFault("a sign is wrong", "core/se2.py", "a + b", "a - b", ("tests/core/test_poses.py",))
    assert fault.planted("c = a + b") == "c = a - b"
    for source in ("c = a * b", "c = a + b + (a + b)"):
        with pytest.raises(ValueError, match="not once"):
            fault.planted(source)


def test_kernels_that_call_a_changed_one_are_compiled_again() -> None:
    assert reached_by("any_angle") == {"any_angle"}
    assert reached_by("line_of_sight") == {"line_of_sight", "visibility"}
    assert reached_by("footprint") == {"footprint", "rollout", "arc", "movers", "primitives"}, "through others, too"
    for path in KERNELS.glob("*.py"):
        others = set(re.findall(r"ambler\.kernels\b.*", path.read_text(encoding="utf-8")))
        told = {line for line in others if re.match(r"ambler\.kernels\.\w+ import ", line)}
        assert others == told or path.stem in ("__init__", "warmup"), "another way of importing would not be seen"
