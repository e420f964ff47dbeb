"""A controller acts once a period, and as soon as it sees something new."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.nodes.sight_rhythm import SightRhythm

MS = 1_000_000


def acts_and_delays(views_ms: list[float], seconds: float, period_ms: float = 50.0) -> tuple[np.ndarray, np.ndarray]:
    """Run a rhythm beside views at given instants; returns when it acted, and how long each view waited for the next act (ms)."""
    rhythm = SightRhythm(1e-3 * period_ms)
    rhythm.act(0)
    acts, views = [0.0], sorted(views_ms)
    now, k = 0, 0
    while now < seconds * 1000 * MS:
        wait = rhythm.wait_ns(now)
        if wait == 0 and acts[-1] < now / MS:
            rhythm.act(now)
            acts.append(now / MS)
            continue
        until = now + max(wait, MS // 10)
        if k < len(views) and views[k] * MS <= until:
            now, k = round(views[k] * MS), k + 1
            if rhythm.see(now):
                rhythm.act(now)
                acts.append(now / MS)
        else:
            now = until
    told = np.array(acts)
    seen = np.array([v for v in views if v < acts[-1]])
    return told, told[np.searchsorted(told, seen - 1e-6)] - seen if len(seen) else seen


def test_without_views_it_keeps_its_period_exactly() -> None:
    acts, _ = acts_and_delays([], 2.0)
    assert np.diff(acts) == pytest.approx(50.0)


@pytest.mark.parametrize("phase", range(0, 100, 7))
@pytest.mark.parametrize("jitter", [0.0, 4.0])
def test_views_of_10_hz_are_acted_on_at_once_and_the_rate_stays(phase: int, jitter: float) -> None:
    rng = np.random.default_rng(phase)
    views = [100.0 * k + phase + jitter * rng.uniform(-1.0, 1.0) for k in range(1, 100)]
    acts, delays = acts_and_delays(views, 10.0)
    assert np.percentile(delays[5:], 95) < 1.0
    assert len(acts) == pytest.approx(200, abs=4)
    assert np.diff(acts)[4:].min() >= 24.9
    assert np.diff(acts)[4:].max() <= 75.1


@pytest.mark.parametrize("rate", [5.0, 7.0, 12.0, 15.0, 20.0, 25.0, 40.0, 50.0])
def test_the_rate_of_acts_does_not_follow_that_of_the_views(rate: float) -> None:
    acts, _ = acts_and_delays([3.0 + 1000.0 * k / rate for k in range(round(20 * rate))], 20.0)
    assert len(acts) / 20.0 == pytest.approx(20.0, rel=0.26)
    assert np.diff(acts)[4:].max() <= 75.1


def test_a_lost_view_and_a_sensor_that_falls_silent_hold_nothing_up() -> None:
    views = [100.0 * k + 30.0 for k in range(1, 50) if k % 7]
    acts, delays = acts_and_delays(views, 10.0)
    assert np.diff(acts).max() <= 75.1
    assert np.median(delays[5:]) < 1.0
    assert np.diff(acts[acts > 5100.0]) == pytest.approx(50.0)
