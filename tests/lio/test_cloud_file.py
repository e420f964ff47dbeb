"""Points on the disk come back as they were, in any order and any thread, take no memory meanwhile, and leave nothing behind."""

from __future__ import annotations

import errno
import gc
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.evaluation.process_memory import STATUS, memory_mb
from ambler.lio.cloud_file import CloudFile, KeptPoints


def drawn(seed: int, count: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).standard_normal((count, 3)).astype(np.float32)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_points_come_back_to_the_bit_in_any_order() -> None:
    file = CloudFile()
    clouds = [drawn(k, count) for k, count in enumerate((5, 0, 20000, 1))]
    kept = [file.put(cloud) for cloud in clouds]
    for k in (3, 0, 2, 1, 2):
        back = kept[k].read()
        assert back.dtype == np.float32
        np.testing.assert_array_equal(back, clouds[k])


def test_threads_do_not_mix_their_points() -> None:
    file = CloudFile()

    def one(seed: int) -> tuple[int, KeptPoints]:
        return seed, file.put(drawn(seed, 500 + seed))

    with ThreadPoolExecutor(4) as pool:
        kept = list(pool.map(one, range(200)))
        backs = list(pool.map(lambda item: (item[0], item[1].read()), kept))
    for seed, back in backs:
        np.testing.assert_array_equal(back, drawn(seed, 500 + seed))


@pytest.mark.skipif(not STATUS.exists(), reason="only Linux tells a process's memory")
def test_what_is_kept_takes_no_memory() -> None:
    file = CloudFile()
    before = memory_mb()
    kept = [file.put(drawn(k, 100_000)) for k in range(100)]  # 120 MB
    assert memory_mb() - before < 20.0
    np.testing.assert_array_equal(kept[57].read(), drawn(57, 100_000))


def test_the_file_has_no_name_and_ends_with_its_last_user(folder: Path) -> None:
    kept = CloudFile().put(drawn(1, 1000))
    assert list(folder.iterdir()) == []
    np.testing.assert_array_equal(kept.read(), drawn(1, 1000))
    opened = len(os.listdir("/proc/self/fd"))
    del kept
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == opened - 1


@pytest.mark.parametrize("at", ["the first", "later"])
def test_what_a_full_disk_refuses_stays_in_memory(at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file = CloudFile()
    kept = [] if at == "the first" else [file.put(drawn(0, 700))]
    write = os.pwrite

    def full(descriptor: int, data: bytes, begin: int) -> int:
        if begin % 100:
            raise OSError(errno.ENOSPC, "no space left on device")
        return write(descriptor, data[: 100 - begin % 100], begin)  # a little fits

    with monkeypatch.context() as patched:
        patched.setattr(os, "pwrite", full)
        kept.append(file.put(drawn(1, 900)))
    kept.append(file.put(drawn(2, 800)))
    for count, seed in ((700, 0), (900, 1), (800, 2))[-len(kept) :]:
        np.testing.assert_array_equal(kept.pop(0).read(), drawn(seed, count))


def test_a_folder_that_cannot_be_written_is_no_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere/at/all")
    np.testing.assert_array_equal(CloudFile().put(drawn(3, 40)).read(), drawn(3, 40))
