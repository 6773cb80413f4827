"""What is at rest: lost samples, bursts, knocks and movements put into a known recording are found, and no others."""
import numpy as np
import pytest

from mems_ins_fusion.characterization.stationary import Grid, StationaryError, find_rest, to_grid

RATE = 100.0


def stamps(n, start=1_700_000_000 * 10**9, rate=RATE):
    return start + np.round(np.arange(n) * 1e9 / rate).astype(np.int64)


def at_rest(seconds, seed=1, rate=RATE):
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    drift = 2e-5 * np.cumsum(rng.standard_normal((n, 6)), axis=0)  # the sensor's own slow error
    return np.array([0.1, -0.2, 9.8, 0.01, 0, 0]) + drift + 0.02 * rng.standard_normal((n, 6))


def test_regular_stamps_are_taken_as_they_are():
    grid = to_grid(stamps(5000), at_rest(50))
    assert grid.rate == pytest.approx(RATE, rel=1e-9)
    assert grid.missing == grid.rejected == 0 and grid.breaks == () and len(grid.values) == 5000


def test_lost_samples_leave_holes_of_their_number():
    # given 3 samples lost at one place and 50 at another
    keep = np.ones(5000, bool)
    keep[[1000, 1001, 1002]] = keep[3000:3050] = False
    values = at_rest(50)
    grid = to_grid(stamps(5000)[keep], values[keep])
    assert grid.missing == 53
    np.testing.assert_array_equal(np.isnan(grid.values[:, 0]), ~keep)
    np.testing.assert_array_equal(grid.values[keep], values[keep])
    assert grid.rate == pytest.approx(RATE, rel=1e-6)


def test_late_samples_are_not_missing():
    # given a driver that stamps on arrival: delays up to 2 ms, and stalls of 8 samples delivered in a burst
    rng = np.random.default_rng(2)
    stamp = stamps(6000) + rng.integers(0, 2_000_000, 6000)
    for start in range(500, 6000, 700):
        stamp[start:start + 8] = stamp[start + 8] - np.arange(8, 0, -1) * 20_000
    grid = to_grid(stamp, at_rest(60))
    assert grid.missing == 0 and grid.rejected == 0 and grid.rate == pytest.approx(RATE, rel=1e-4)


def test_repeated_and_backward_stamps_are_rejected():
    stamp = stamps(5000)
    stamp[100] = stamp[99]
    stamp[200] = stamp[150]
    grid = to_grid(stamp, at_rest(50))
    assert grid.rejected == 2 and grid.missing == 2


def test_long_pause_begins_a_new_part():
    stamp = stamps(30_000)
    stamp[15_000:] += 3600 * 10**9
    grid = to_grid(stamp, at_rest(300))
    assert len(grid.values) == 30_000 and grid.breaks == (15_000,)
    rest = find_rest(grid)
    assert rest.parts == ((0, 15_000), (15_000, 30_000))
    assert any('gap' in cut.reason for cut in rest.cuts)
    assert grid.rate == pytest.approx(RATE, rel=1e-4)


def test_sensor_at_rest_is_kept_whole():
    for seed in range(5):
        values = at_rest(600, seed)
        rest = find_rest(Grid(RATE, values))
        assert rest.parts == ((0, 60_000),) and rest.cuts == () and not rest.holes.any() and rest.shifts == ()


def test_knock_leaves_a_hole_and_the_level():
    values = at_rest(600)
    values[30_000:30_040, :3] += 2 * np.sin(np.arange(40))[:, None]
    rest = find_rest(Grid(RATE, values))
    assert rest.parts == ((0, 60_000),)
    assert rest.holes[30_000:30_040].all() and rest.holes.sum() <= 4 * RATE
    assert [cut.reason for cut in rest.cuts] == ['knock']
    assert rest.cuts[0].start <= 300 <= rest.cuts[0].stop


def test_movement_begins_a_new_part():
    # given a sensor that is picked up for 5 s and put down with another tilt
    values = at_rest(600)
    values[30_000:30_500] += np.random.default_rng(3).standard_normal((500, 6))
    values[30_500:, 0] += 0.5
    rest = find_rest(Grid(RATE, values))
    assert len(rest.parts) == 2
    assert rest.parts[0][1] <= 30_000 and 30_500 <= rest.parts[1][0] <= 30_700
    assert [cut.reason for cut in rest.cuts] == ['moved: another level after it']


def test_sudden_step_of_the_level_begins_a_new_part():
    values = at_rest(600)
    values[30_000:, 1] += 0.3
    rest = find_rest(Grid(RATE, values))
    assert [abs(a - 30_000) <= RATE for a, _ in rest.parts[1:]] == [True]


def test_small_shift_of_the_level_is_reported_and_kept():
    values = at_rest(1200)
    values[60_000:, 2] += 0.015
    rest = find_rest(Grid(RATE, values))
    assert rest.parts == ((0, 120_000),)
    (time, column, size), = rest.shifts
    assert time == pytest.approx(600, abs=5) and column == 2 and size == pytest.approx(0.015, rel=0.3)


def test_driving_is_no_rest():
    # given a drive with stops of 20 s, each on another slope
    rng = np.random.default_rng(4)
    values = at_rest(600)
    moving = (np.arange(60_000) // 2000) % 3 != 0
    values[moving] += rng.standard_normal((moving.sum(), 6))
    values[:, 0] += np.repeat(0.3 * rng.standard_normal(10), 6000)
    with pytest.raises(StationaryError, match='without being moved'):
        find_rest(Grid(RATE, values))


def test_dead_axis_and_short_recordings_are_named():
    values = at_rest(100)
    values[:, 4] = 0.0
    with pytest.raises(StationaryError, match='gyroscope y'):
        find_rest(Grid(RATE, values))
    with pytest.raises(StationaryError, match='too short'):
        find_rest(Grid(RATE, at_rest(30)))
    with pytest.raises(StationaryError, match='too few'):
        to_grid(stamps(50), at_rest(0.5))
