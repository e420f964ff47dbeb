"""Large arrays must go back to the system; the C library's habits are those of a whole process, so each case has one of its own."""

import subprocess
import sys

import pytest

CODE = """
import re
import numpy as np
from pathlib import Path
from ambler.core.large_memory import give_back_large_arrays

def held():
    return int(re.search(r"VmRSS:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1e3

if {asks}:
    assert give_back_large_arrays()
np.ones(3_000_000)  # 24 MB: the C library takes it for a sign when it is dropped
before, small = held(), []
for _ in range(10):
    large = np.ones(2_000_000)
    small.append(np.ones(20_000))
    del large
    more = np.ones(1_500_000)
    small.append(np.ones(10_000))
    del more
print(held() - before - sum(a.nbytes for a in small) / 1e6)
"""


def kept_mb(*, asks: bool) -> float:
    done = subprocess.run([sys.executable, "-c", CODE.format(asks=asks)], capture_output=True, text=True, check=True)
    return float(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the C library of Linux")
def test_arrays_of_a_hall_leave_no_holes() -> None:
    assert kept_mb(asks=True) < 2.0


HOLES = """
import re, time
import numpy as np
from pathlib import Path
from ambler.core.large_memory import give_back_holes_every

def held():
    return int(re.search(r"VmRSS:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1e3

if {asks}:
    give_back_holes_every(0.05)
before = held()
things = [np.ones(12_000) for _ in range(1000)]  # 96 MB
things = things[::10]
for _ in range(100 if {asks} else 5):
    if held() - before < 30.0:
        break
    time.sleep(0.1)
print(held() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the C library of Linux")
def test_holes_between_what_is_kept_go_back_while_the_process_works() -> None:
    kept = [
        float(
            subprocess.run(
                [sys.executable, "-c", HOLES.format(asks=asks)], capture_output=True, text=True, check=True
            ).stdout
        )
        for asks in (True, False)
    ]
    assert kept[0] < 30.0
    assert kept[1] > 80.0, "else the test tells nothing"


OWN = """
import sys, threading
from ambler.cli.main import main

def threads():
    return sum(thread.name == "memory" for thread in threading.enumerate())

words = ["config", "check", "/nowhere.yaml"]
assert main(words) == 2
assert threads() == 0, "the process is somebody else's"
sys.argv = ["ambler", *words]
for _ in range(2):
    assert main() == 2
assert threads() == 1
"""


def test_only_a_process_of_the_command_itself_gets_its_habits() -> None:
    done = subprocess.run([sys.executable, "-c", OWN], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
