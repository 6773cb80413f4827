"""Allan deviation against its definition, against allantools, and on sensors with known coefficients."""
import numpy as np
import pytest

from mems_ins_fusion.characterization.allan import allan_deviation, allan_parameters, degrees_of_freedom
from mems_ins_fusion.sensor_errors.models import GaussMarkov, RandomWalk, simulate

RATE = 10.0
N = 2e-3


def white(n, rng):
    return N * np.sqrt(RATE) * rng.standard_normal(n)


def by_definition(x, m):
    """Half the mean square of the difference of adjacent means, over all positions; a mean over few samples is none."""
    pairs = [(x[i:i + m], x[i + m:i + 2 * m]) for i in range(len(x) - 2 * m + 1)]
    pairs = [(a, b) for a, b in pairs if min(np.isfinite(a).sum(), np.isfinite(b).sum()) >= 0.9 * m]
    return np.sqrt(np.mean([(np.nanmean(b) - np.nanmean(a)) ** 2 for a, b in pairs]) / 2)


@pytest.mark.parametrize('missing', [False, True])
def test_deviation_is_that_of_the_definition(missing):
    x = np.random.default_rng(1).standard_normal(400).cumsum() + 50
    if missing:
        x[[40, 41, 200]] = np.nan
    curve = allan_deviation(x, RATE)
    for tau, deviation in zip(curve.tau, curve.deviation):
        assert deviation == pytest.approx(by_definition(x, round(tau * RATE)), rel=1e-9)


def test_deviation_and_degrees_of_freedom_agree_with_allantools():
    allantools = pytest.importorskip('allantools', reason='allantools, the judge of this test, is not installed')
    x = white(5000, np.random.default_rng(2)) + 9.8
    curve = allan_deviation(x, RATE)
    taus, deviation, *_ = allantools.oadev(x, rate=RATE, data_type='freq', taus=curve.tau)
    np.testing.assert_allclose(taus, curve.tau)
    np.testing.assert_allclose(curve.deviation, deviation, rtol=1e-8)
    for slope, alpha in ((-0.5, 0), (0.0, -1), (0.5, -2)):
        for m in (2, 10, 300):
            assert degrees_of_freedom(5001, m, slope) == pytest.approx(allantools.edf_simple(5001, m, alpha), rel=1e-6)


def test_parts_are_pooled_and_never_bridged():
    rng = np.random.default_rng(3)
    x = white(20000, rng)
    whole = allan_deviation(x, RATE)
    parts = allan_deviation([x[:10000], x[10000:] + 5.0], RATE)  # the sensor was tilted in between
    np.testing.assert_allclose(parts.deviation[:30], np.interp(parts.tau[:30], whole.tau, whole.deviation), rtol=0.1)


def test_white_noise_shows_its_density_and_no_random_walk():
    # given pure white noise, 40 times
    found = [allan_parameters(allan_deviation(white(20000, np.random.default_rng([4, s])), RATE)) for s in range(40)]
    # then N is right within its sigma, and there is no random walk
    errors = [(p.noise_density - N) / p.noise_density_sigma for p in found]
    assert 0.6 < np.std(errors) < 1.5 and abs(np.mean(errors)) < 3 / np.sqrt(40)
    assert sum(p.random_walk is not None for p in found) == 0
    assert sum(p.bias_instability is not None for p in found) <= 2


def test_random_walk_is_recovered_within_its_uncertainty():
    q = 3e-4
    errors = []
    for s in range(20):
        rng = np.random.default_rng([5, s])
        p = allan_parameters(allan_deviation(white(36000, rng) + simulate(RandomWalk(q, 0), 36000, 0.1, rng), RATE))
        assert p.noise_density == pytest.approx(N, rel=0.05)
        errors.append((p.random_walk - q) / p.random_walk_sigma)
    assert np.sqrt(np.mean(np.square(errors))) < 1.8


def test_hump_of_a_gauss_markov_process_shows_its_correlation_time():
    rng = np.random.default_rng(6)
    x = white(200000, rng) + simulate(GaussMarkov(5e-3, 60.0), 200000, 0.1, rng)
    p = allan_parameters(allan_deviation(x, RATE))
    assert p.correlation_time == pytest.approx(60, rel=0.4)
    assert p.bias_instability is not None


def test_bounds_hold_the_truth():
    # white noise: the true deviation is N / sqrt(tau); 95 % bounds at three averaging times, 60 recordings
    inside = 0
    for s in range(60):
        curve = allan_deviation(white(4000, np.random.default_rng([7, s])), RATE)
        for tau in (0.1, 3.2, 25.6):
            i = np.argmin(np.abs(curve.tau - tau))
            inside += curve.lower[i] < N / np.sqrt(curve.tau[i]) < curve.upper[i]
    assert 0.89 * 180 <= inside <= 178


def test_too_short_a_record_is_refused():
    with pytest.raises(ValueError, match='at least 16 samples'):
        allan_deviation(np.zeros(10), RATE)
