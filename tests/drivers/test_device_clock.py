"""A device's clock against a model of it: offset, drift, jitter of the line, jumps, and counters that wrap."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.drivers.device_clock import DeviceClock, DeviceStamps

LEAST_DELAY = 300_000
START = 1_790_000_000_000_000_000


def measured(
    seed: int, seconds: float, rate: float, drift: float, jitter: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants (host), device stamps (ns since its start) and arrivals of messages over a line with an exponential delay."""
    rng = np.random.default_rng(seed)
    count = int(seconds * rate)
    instants = START + (np.arange(count) * 1e9 / rate).astype(np.int64)
    device = ((instants - START) * (1.0 + drift)).astype(np.int64)
    delays = LEAST_DELAY + (rng.exponential(jitter, count) * 1e9).astype(np.int64)
    return instants, device, np.maximum.accumulate(instants + delays)


def translate(clock: DeviceClock, ticks: list[int], arrivals: list[int]) -> np.ndarray:
    stamps, out = DeviceStamps(clock), []
    for tick, arrival in zip(ticks, arrivals, strict=True):
        clock.observe(tick, arrival)
        out.append(stamps.to_host(tick, arrival))
    return np.array(out)


@settings(deadline=None, max_examples=25, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.floats(-1e-4, 1e-4), st.floats(0.0, 0.003), st.sampled_from((20.0, 100.0)))
def test_stamps_follow_a_drifting_clock_through_jitter(seed: int, drift: float, jitter: float, rate: float) -> None:
    instants, device, arrivals = measured(seed, 60.0, rate, drift, jitter)
    clock = DeviceClock()
    host = translate(clock, device.tolist(), arrivals.tolist())
    assert (np.diff(host) > 0).all()
    assert (host <= arrivals).all()
    settled = instants - START > 5_000_000_000
    error = (host - instants)[settled] * 1e-9
    # Late by the least delay and what a slice of one second leaves of jitter and drift; a plain minimum over 10 s would err by 1 ms.
    assert error.max() < 0.0003 + 0.0002 + 3.0 * jitter / rate
    assert error.min() > 0.0003 - 0.0006
    assert clock.jumps == 0


def test_a_drift_of_100_ppm_is_followed_to_a_tenth_of_a_millisecond() -> None:
    instants, device, arrivals = measured(5, 120.0, 50.0, 1e-4, 0.002)
    host = translate(DeviceClock(), device.tolist(), arrivals.tolist())
    settled = instants - START > 12_000_000_000
    assert np.abs(host - instants - LEAST_DELAY)[settled].max() < 250_000
    assert np.abs(np.mean((host - instants - LEAST_DELAY)[settled])) < 60_000


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0.03, 3000.0).flatmap(lambda size: st.sampled_from((size, -size))),
    st.floats(0.0, 0.002),
)
def test_a_jump_is_counted_once_measured_and_survived(seed: int, jump: float, jitter: float) -> None:
    instants, device, arrivals = measured(seed, 20.0, 50.0, 5e-5, jitter)
    after = instants - START > 10_000_000_000
    device = device + np.where(after, round(jump * 1e9), 0)
    clock = DeviceClock()
    host = translate(clock, device.tolist(), arrivals.tolist())
    assert clock.jumps == 1
    assert clock.last_jump == pytest.approx(jump, abs=0.02)
    assert f"{clock.last_jump:+.3f} s" in clock.text
    assert (np.diff(host) > 0).all()
    assert (host <= arrivals + 1).all()
    settled = instants - START > 13_000_000_000
    assert np.abs(host - instants)[settled].max() < 3_000_000


def test_a_small_jump_back_is_found_although_stamps_still_rise() -> None:
    instants, device, arrivals = measured(3, 20.0, 10.0, 0.0, 0.001)
    device = device - np.where(instants - START > 8_000_000_000, 40_000_000, 0)
    assert (np.diff(device) > 0).all()
    clock = DeviceClock()
    host = translate(clock, device.tolist(), arrivals.tolist())
    assert clock.jumps == 1
    assert clock.last_jump == pytest.approx(-0.04, abs=0.005)
    assert np.abs(host - instants)[-50:].max() < 3_000_000


def test_a_host_that_sleeps_is_no_jump_of_the_device() -> None:
    instants, device, arrivals = measured(4, 20.0, 50.0, 0.0, 0.001)
    asleep = (arrivals > START + 8_000_000_000) & (arrivals < START + 11_000_000_000)
    arrivals = np.where(asleep, START + 11_000_000_000, arrivals)
    clock = DeviceClock()
    host = translate(clock, device.tolist(), arrivals.tolist())
    assert clock.jumps == 0
    assert np.abs(host - instants)[100:].max() < 3_000_000


def test_late_first_messages_are_no_jump() -> None:
    clock = DeviceClock()
    host = translate(
        clock, [0, 10_000_000, 20_000_000], [START + 900_000_000, START + 900_100_000, START + 20_500_000 + 880_000_000]
    )
    assert clock.jumps == 0
    assert host[-1] - START == 20_000_000 + 880_500_000


@settings(deadline=None, max_examples=20, derandomize=True)
@given(st.integers(0, 2**20 - 1), st.integers(0, 2**32 - 1))
def test_a_counter_that_wraps_gives_the_same_stamps_as_one_that_does_not(start: int, seed: int) -> None:
    _, device, arrivals = measured(seed, 10.0, 50.0, 1e-4, 0.001)
    ticks = device // 1000 + start
    plain = translate(DeviceClock(1000), ticks.tolist(), arrivals.tolist())
    wrapping = translate(DeviceClock(1000, bits=20), (ticks % 2**20).tolist(), arrivals.tolist())
    assert (plain == wrapping).all()


def test_a_wrap_during_a_long_silence_is_found_by_the_hosts_clock() -> None:
    clock = DeviceClock(1000, bits=20)
    clock.observe(5, START)
    silence_us = 5 * 2**20 + 77
    clock.observe((5 + silence_us) % 2**20, START + 1000 * silence_us)
    assert clock.to_host(5 + 77) == START + 1000 * silence_us


def test_offset_is_told_in_seconds() -> None:
    clock = DeviceClock()
    assert clock.offset is None
    clock.observe(1_000_000_000, 3_500_000_000)
    assert clock.offset == pytest.approx(2.5)
    with pytest.raises(ValueError, match="observed"):
        DeviceClock().to_host(1)


def test_a_repeated_stamp_stays_equal() -> None:
    clock = DeviceClock()
    clock.observe(100, 200)
    stamps = DeviceStamps(clock)
    assert [stamps.to_host(t, a) for t, a in itertools.product((100,), (200, 300))] == [200, 200]
