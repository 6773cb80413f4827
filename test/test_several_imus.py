"""Two IMUs as one stream of samples, judged by a motion that is known."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.cli.simulate import main as simulate
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.second_imu import compare_imus
from mems_ins_fusion.filter.runs.imu_comparison import is_noisier
from mems_ins_fusion.filter.runs.imu_memory import book_of, keep
from mems_ins_fusion.filter.runs.imus import Imus, as_one
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.reports.replay import read_part
from mems_ins_fusion.samples import ImuSamples, Recording

TURNED = [0.4, -0.2, 2.0]
FIRST_MOUNTING = [0.1, 0.0, -0.5]
GIVEN = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second', 'second.mounting_rpy': TURNED,
         'imu.mounting_rpy': FIRST_MOUNTING}
VALUES = table.check(GIVEN)
NOISE = np.repeat([0.02, 0.002], 3)
BIAS = np.array([0.1, -0.2, 0.05, 0.01, -0.005, 0.008])
SECOND_BIAS = np.array([-0.3, 0.1, 0.2, -0.01, 0.02, 0.004])
BEGIN = 1_700_000_000 * 10**9
STEADY = 40.0  # s: by then the second one is known


def motion(time):
    """Specific force and angular rate (n, 6) of a vehicle in its axes, forward-left-up; it stands till 10 s."""
    moving = time > 10.0
    slow = np.where(moving, 1.0, 0.0)[:, None] * np.column_stack([
        np.sin(0.7 * time), 1.5 * np.sin(0.4 * time), 0.3 * np.sin(1.1 * time),
        0.01 * np.sin(1.3 * time), 0.02 * np.cos(0.9 * time), 0.15 * np.sin(0.4 * time)])
    return slow + [0.0, 0.0, 9.81, 0.0, 0.0, 0.0]


def imu(seed, rpy, bias, begin=0.0, duration=120.0, rate=100.0, noise=NOISE):
    """An IMU in its own axes."""
    time = begin + np.arange(round(duration * rate)) / rate
    to_sensor = rotation_from_rpy(*rpy)
    true = motion(time)
    values = np.hstack([true[:, :3] @ to_sensor, true[:, 3:] @ to_sensor]) + bias
    values += noise * np.random.default_rng(seed).standard_normal(values.shape)
    stamp = BEGIN + np.round(time * 1e9).astype(np.int64)
    return ImuSamples(stamp, stamp.copy(), values[:, :3].copy(), values[:, 3:].copy())


@pytest.fixture(scope='module')
def first():
    return imu(1, FIRST_MOUNTING, BIAS)


@pytest.fixture(scope='module')
def second():
    return imu(2, TURNED, SECOND_BIAS, 0.0043)


def one(first, second, values=VALUES):
    """The stream, and what was said."""
    several = Imus(values)
    return several.of_recording(first, {'second': second}), [notice.text for notice in several.notices()]


def seconds(samples):
    return (samples.stamp - BEGIN) * 1e-9


def errors(samples):
    """What the samples, axes of the first IMU, are off the motion, (n, 6)."""
    to_sensor, true = rotation_from_rpy(*FIRST_MOUNTING), motion(seconds(samples))
    return np.hstack([samples.specific_force, samples.angular_rate]) - np.hstack([true[:, :3] @ to_sensor,
                                                                                  true[:, 3:] @ to_sensor])


def means(error, count=100):
    return error[:len(error) // count * count].reshape(-1, count, 6).mean(axis=1)


def after(samples, begin, end=1e9):
    return (seconds(samples) >= begin) & (seconds(samples) < end)


def test_two_that_agree_are_averaged_with_the_biases_of_the_first(first, second):
    # given two IMUs with one noise, axes, stamps and biases of their own; when they are one
    whole, said = one(first, second)
    # then there is a sample for each of the first, and the errors of means over a second are those of a mean of two
    np.testing.assert_array_equal(whole.stamp, first.stamp)
    shown = means(errors(whole)[after(whole, STEADY)])
    alone = NOISE / np.sqrt(100)
    assert (shown.std(axis=0) < 0.85 * alone).all() and (shown.std(axis=0) > 0.55 * alone).all()
    # and the biases are the first one's, to what 20 s of both tell
    assert (np.abs(shown.mean(axis=0) - BIAS) < 5 * NOISE * np.sqrt(2 / 2000)).all()
    assert any('averaged with /imu/data from now on' in text for text in said)


def test_what_both_measure_is_not_late(first, second):
    # given the same, without noise; then a difference between stamps of 4 ms does not show: of 0.7 rad/s and 1 m/s^2 it
    # would be 1.5 mm/s^2
    none = np.zeros(6)
    whole, _ = one(imu(1, FIRST_MOUNTING, BIAS, noise=none), imu(2, TURNED, SECOND_BIAS, 0.0043, noise=none))
    assert np.abs(errors(whole)[after(whole, STEADY), :3] - BIAS[:3]).max() < 3e-4


def test_the_noisier_one_counts_less(first):
    whole, _ = one(first, imu(2, TURNED, SECOND_BIAS, 0.0043, noise=5 * NOISE))
    shown = means(errors(whole)[after(whole, STEADY)]).std(axis=0)
    assert (shown < 1.1 * NOISE / 10).all()


def test_message_by_message_gives_the_same_bits(first, second):
    # given all that changes the stream: one that stops, comes back, differs
    first = first.select(~after(first, 50.0, 60.0))
    second = replace(second, angular_rate=second.angular_rate + np.where(after(second, 100.0)[:, None], 0.1, 0.0))
    values = table.check({**GIVEN, 'second.lever_arm': [0.3, -0.2, 0.1]})
    whole, said = one(first, second, values)
    several, got = Imus(values), []
    parts = (first, second)
    order = sorted((int(stamp), source, i) for source, part in enumerate(parts)
                   for i, stamp in enumerate(part.received))
    for _, source, i in order:
        got += several.add(source, int(parts[source].stamp[i]), parts[source].specific_force[i].tolist(),
                           parts[source].angular_rate[i].tolist())
    assert [stamp for stamp, _ in got] == whole.stamp.tolist()
    np.testing.assert_array_equal([numbers for _, numbers in got],
                                  np.hstack([whole.specific_force, whole.angular_rate, whole.difference]))
    assert [notice.text for notice in several.notices()] == said[:len(said)]


def test_one_that_stops_is_replaced_without_a_gap_or_a_jump(first, second):
    # given the first one silent from 60 s on
    whole, said = one(first.select(~after(first, 60.0)), second)
    # then samples go on to the end, none further apart than those of an IMU, with the biases of the first
    assert whole.stamp[-1] == second.stamp[-1]
    assert 0 < np.diff(whole.stamp).min() and np.diff(whole.stamp).max() <= 15_000_000
    shown = errors(whole)[after(whole, 60.0)].mean(axis=0)
    assert (np.abs(shown - BIAS) < 5 * NOISE * np.sqrt(2 / 2000)).all()
    # and it is said once
    assert [text for text in said if 'no sample for 0.2' in text and '/second are used from now on' in text]
    assert len(said) == 2


def test_biases_that_are_others_after_a_restart_are_taken_out(first, second):
    # given the first one away for 5 s, with other biases from then on
    more = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.03])
    changed = replace(first, specific_force=first.specific_force + np.where(after(first, 35.0)[:, None], more[:3], 0.0),
                      angular_rate=first.angular_rate + np.where(after(first, 35.0)[:, None], more[3:], 0.0))
    whole, said = one(changed.select(~after(changed, 30.0, 35.0)), second)
    # then the stream has the biases that it had, all the time
    for begin in (30.0, 60.0, 100.0):
        shown = errors(whole)[after(whole, begin, begin + 15.0)].mean(axis=0)
        assert (np.abs(shown - BIAS) < 0.1 * np.maximum(more, np.repeat([0.1, 0.01], 3))).all(), begin
    assert any('/imu/data: its constant difference to /second has changed' in text for text in said)


@pytest.mark.parametrize('broken', ['first', 'second'])
def test_one_that_stays_as_it_is_is_not_used(first, second, broken):
    # given an IMU that repeats one sample from 60 s on, beside one that does not
    def stuck(samples):
        at = np.flatnonzero(after(samples, 60.0))
        parts = {name: getattr(samples, name).copy() for name in ('specific_force', 'angular_rate')}
        for values in parts.values():
            values[at] = values[at[0]]
        return replace(samples, **parts)
    whole, said = one(*((stuck(first), second) if broken == 'first' else (first, stuck(second))))
    # then within half a second only the other one is used, and it is said
    off = np.abs(errors(whole)[after(whole, 60.5)] - BIAS)
    assert (off < 6 * NOISE + 3e-3).all()
    assert any('frozen' in text for text in said)


def led(samples):
    """Specific force and angular rate (n, 6) of the leading IMU where the samples are the mean of two that differ."""
    return np.hstack([samples.specific_force, samples.angular_rate]) - 0.5 * samples.difference


def test_where_they_differ_the_mean_and_the_difference_are_handed_on_and_it_is_said(first, second):
    # given the second one's gyroscope off by 0.1 rad/s from 60 s on, while the vehicle moves
    off = np.where(after(second, 60.0)[:, None], [0.0, 0.1, 0.0], 0.0) @ rotation_from_rpy(*TURNED)
    whole, said = one(first, replace(second, angular_rate=second.angular_rate + off))
    # then that shows before it has turned the heading by 0.01 rad
    begin = seconds(whole)[np.flatnonzero(whole.difference.any(axis=1))[0]]
    step = errors(whole)[after(whole, 60.0, begin), 3:] - BIAS[3:]
    assert 60.0 < begin < 60.5 and np.abs(step.sum(axis=0) * 0.01).max() < 0.01
    # and from then on the difference is handed on, and the first one's samples can be had from it
    apart = after(whole, begin, 110.0)
    np.testing.assert_allclose(led(whole)[apart, 3:], first.angular_rate[apart], atol=1e-12)
    in_first = rotation_from_rpy(*FIRST_MOUNTING).T @ [0.0, 0.1, 0.0]
    np.testing.assert_allclose(whole.difference[apart, 3:].mean(axis=0), in_first, atol=5e-4)
    assert any('/second: it differs from /imu/data by' in text and 'rad/s' in text and 'not averaged' in text
               for text in said)


def test_it_is_a_fallback_and_no_more_until_both_have_moved():
    # given two that stand for a minute and then drive
    parts = [imu(1, FIRST_MOUNTING, BIAS, -50.0, 110.0), imu(2, TURNED, SECOND_BIAS, -49.9957, 110.0)]
    whole, said = one(*parts)
    # then till they have moved, the samples are those of the first one, to the bit; and then they are averaged
    still = after(whole, -50.0, 10.0)
    np.testing.assert_array_equal(whole.specific_force[still], parts[0].specific_force[still])
    np.testing.assert_array_equal(whole.angular_rate[still], parts[0].angular_rate[still])
    shown = means(errors(whole)[after(whole, 40.0)]).std(axis=0)
    assert (shown < 0.85 * NOISE / np.sqrt(100)).all() and len(said) == 1


def delayed(samples, by):
    """They show what was `by` s ago."""
    return replace(samples, stamp=samples.stamp + round(by * 1e9), received=samples.received + round(by * 1e9))


def scaled(samples, by):
    return replace(samples, specific_force=by * samples.specific_force, angular_rate=by * samples.angular_rate)


def of_other_axes(samples):
    return replace(samples, specific_force=samples.specific_force[:, [1, 0, 2]],
                   angular_rate=samples.angular_rate[:, [1, 0, 2]])


WRONG = {'half a second late': lambda s: delayed(s, 0.5), 'a fifth late': lambda s: delayed(s, 0.2),
         'scale 5 % more': lambda s: scaled(s, 1.05), 'in degrees': lambda s: replace(
             s, angular_rate=np.degrees(s.angular_rate)), 'axes exchanged': of_other_axes,
         'received 0.5 s later': lambda s: replace(s, received=s.received + 500_000_000),
         'silent for 3 s of each 10': lambda s: s.select(seconds(s) % 10.0 < 7.0)}


@pytest.mark.parametrize('wrong', WRONG)
def test_one_that_is_wrong_leaves_the_samples_of_the_first_in_the_mean(first, second, wrong):
    # given a second one that is wrong from the start, which no constant and no noise explains; when they are one
    whole, said = one(first, WRONG[wrong](second))
    # then the samples are those of the first one, to the bit till it is known that they differ
    np.testing.assert_array_equal(whole.stamp, first.stamp)
    np.testing.assert_allclose(led(whole), np.hstack([first.specific_force, first.angular_rate]), atol=1e-10)
    same = ~whole.difference.any(axis=1)
    assert same[after(whole, 0.0, 20.0)].all()
    np.testing.assert_array_equal(whole.angular_rate[same], first.angular_rate[same])
    # and it is said once, where it differs and does not only come late
    assert sum('it differs' in text for text in said) == (not wrong.startswith(('received', 'silent')))
    assert not any('averaged with' in text for text in said)


def test_one_that_becomes_wrong_in_motion_is_out_at_once(first, second):
    # given two that are averaged, the second of which is half a second late from 60 s on
    late = delayed(second, 0.5)
    at = after(second, 60.0)
    broken = ImuSamples(second.stamp, second.received, *(
        np.where(at[:, None], np.roll(getattr(second, name), 50, axis=0), getattr(second, name))
        for name in ('specific_force', 'angular_rate')))
    assert len(late) == len(broken)
    whole, said = one(first, broken)
    # then it is not averaged any more as soon as that shows, and what it added till then is small
    assert sum('it differs' in text for text in said) == 1
    apart = after(whole, 66.0)
    np.testing.assert_allclose(led(whole)[apart, 3:], first.angular_rate[apart], atol=1e-12)
    begin = seconds(whole)[np.flatnonzero(whole.difference.any(axis=1))[0]]
    added = (whole.angular_rate - first.angular_rate)[after(whole, 60.0, begin)]
    assert np.abs(added.sum(axis=0) * 0.01).max() < 0.01


def test_one_that_loses_a_third_of_its_samples_is_still_of_use(first, second):
    kept = np.random.default_rng(5).random(len(second)) > 0.3
    whole, said = one(first, second.select(kept))
    shown = means(errors(whole)[after(whole, STEADY)]).std(axis=0)
    assert (shown < 0.9 * NOISE / np.sqrt(100)).all() and len(said) == 1


def test_one_that_has_never_agreed_leads_only_where_the_first_stays_away(first, second):
    # given a second one whose axes are exchanged, and a first one that is silent for a second, and then for 15 s
    silent = after(first, 50.0, 51.0) | after(first, 70.0, 85.0)
    whole, said = one(first.select(~silent), of_other_axes(second))
    # then it does not lead in the second, which the filter bridges, and in the 15 s nothing else is there
    gap = np.diff(whole.stamp) * 1e-9
    assert np.count_nonzero(gap > 0.5) == 1 and (gap < 1.02).all()
    assert after(whole, 70.0, 85.0).sum() > 1400
    # and half a minute after it is back the first one leads, with its own biases
    back = after(whole, 110.0)
    np.testing.assert_array_equal(whole.angular_rate[back], first.angular_rate[after(first, 110.0)])
    assert sum('instead of those of /second' in text for text in said) == 1


def test_the_first_leads_again_when_it_agrees_again(first, second):
    # given the first one away for 5 s, back with the biases that it had
    whole, said = one(first.select(~after(first, 50.0, 55.0)), second)
    # then 20 s later samples come at its stamps again, averaged, without a jump
    assert any('/imu/data: leads again' in text for text in said)
    assert np.isin(whole.stamp[after(whole, 90.0)], first.stamp).all()
    shown = errors(whole)
    assert (means(shown[after(whole, 90.0)]).std(axis=0) < 0.85 * NOISE / np.sqrt(100)).all()
    step = shown[after(whole, 90.0)].mean(axis=0) - shown[after(whole, 40.0, 50.0)].mean(axis=0)
    assert (np.abs(step) < 5 * NOISE * np.sqrt(2 / 1000)).all()


@pytest.mark.parametrize('broken', ['not a number', 'out of range'])
def test_a_leading_one_that_is_not_believed_is_replaced(first, second, broken):
    at = after(first, 60.0)
    value = np.nan if broken == 'not a number' else 1e4
    wrong = replace(first, specific_force=np.where(at[:, None], value, first.specific_force))
    whole, said = one(wrong, second)
    assert np.isfinite(whole.specific_force).all() and np.diff(whole.stamp).max() < 15_000_000
    assert (np.abs(errors(whole)[after(whole, 60.0)] - BIAS) < 6 * NOISE + 3e-3).all()
    assert any(f'samples rejected: {broken}: the samples of /second' in text for text in said)


def noisy(imu, begin, end=1e9):
    """The samples with 50 times the noise from `begin` to `end`, s."""
    at, rng = after(imu, begin, end)[:, None], np.random.default_rng(6)
    return replace(imu, specific_force=imu.specific_force + np.where(at, rng.normal(0, 1.0, (len(at), 3)), 0.0),
                   angular_rate=imu.angular_rate + np.where(at, rng.normal(0, 0.1, (len(at), 3)), 0.0))


@pytest.mark.parametrize('late', [0.0, 0.1])
def test_a_leading_one_that_becomes_noisy_is_replaced(first, second, late):
    # given 50 times the noise from 60 s on; the other one's messages come at once, or late
    second = replace(second, received=second.stamp + round(late * 1e9))
    whole, said = one(noisy(first, 60.0), second)
    # then within seconds it is the second one alone, with the biases of the first
    shown = errors(whole)[after(whole, 63.0)] - BIAS
    assert (shown.std(axis=0) < 1.1 * NOISE).all() and (np.abs(shown.mean(axis=0)) < 0.1 * NOISE).all()
    assert any('times as noisy, /second has not' in text for text in said)
    # and no sample is handed on twice, or goes back
    assert (np.diff(whole.stamp) > 0).all() and np.diff(whole.stamp).max() < (0.015 + late) * 1e9


@pytest.mark.parametrize('which', ['first', 'second'])
def test_noise_that_is_over_does_not_make_two_differ(first, second, which):
    # given 50 times the noise for 20 s
    given = (noisy(first, 60.0, 80.0), second) if which == 'first' else (first, noisy(second, 60.0, 80.0))
    whole, said = one(*given)
    # then the filter need not judge them, its samples have next to nothing of that noise
    assert not any('it differs' in text for text in said) and not whole.difference.any()
    shown = errors(whole)[after(whole, 60.5, 80.0)] - BIAS
    assert (shown.std(axis=0) < 1.1 * NOISE).all()
    # and later both are averaged again, with the constant difference that they had
    shown = means(errors(whole)[after(whole, 105.0)] - BIAS)
    assert (shown.std(axis=0) < 0.85 * NOISE / np.sqrt(100)).all()
    assert (np.abs(shown.mean(axis=0)) < 5 * NOISE * np.sqrt(2 / 1500)).all()


def test_a_constant_that_drifts_adds_no_more_than_it_changes_in_a_minute(first, second):
    # given a second one whose rate changes by 0.01 rad/s in 100 s
    drift = np.outer(1e-4 * seconds(second), [0.0, 0.0, 1.0]) @ rotation_from_rpy(*TURNED)
    whole, _ = one(first, replace(second, angular_rate=second.angular_rate + drift))
    shown = means(errors(whole)[after(whole, STEADY)])[:, 3:] - BIAS[3:]
    assert np.abs(shown).max() < 0.5 * 60.0 * 1e-4


def test_messages_that_come_twice_change_nothing_but_that_the_filter_hears_of_them(first, second):
    double = second.select(np.repeat(np.arange(len(second)), 2))
    np.testing.assert_array_equal(one(first, double)[0].specific_force, one(first, second)[0].specific_force)
    twice, _ = one(first.select(np.repeat(np.arange(len(first)), 2)), second)
    assert len(twice) == 2 * len(first)  # the intake drops and names them, as of one IMU alone
    kept = np.flatnonzero(np.diff(twice.stamp, prepend=0) > 0)
    np.testing.assert_allclose(twice.specific_force[kept], one(first, second)[0].specific_force, atol=1e-9)


def test_only_the_second_is_there(second):
    whole, said = one(second.select(slice(0, 0)), second)
    assert whole.stamp[-1] == second.stamp[-1] and seconds(whole)[0] < 6.0
    assert 'no sample for 5.0' in said[0]


def test_a_params_file_of_one_imu_is_none_the_wiser(first):
    recording = Recording('r', first)
    assert as_one(recording, table.defaults())[0] is recording


def test_what_its_parameters_have_to_be():
    with pytest.raises(ParameterError, match=r"'second.mounting_rpy' must have 3 values"):
        table.check({**GIVEN, 'second.mounting_rpy': [0.0]})
    with pytest.raises(ParameterError, match="unknown parameter 'second.sigma'"):
        table.check({**GIVEN, 'second.sigma': 1.0})


def test_a_simulated_bag_with_two_is_read_as_one_and_without_either(tmp_path):
    # given a bag of `simulate` with the second IMU turned and half a metre behind
    params = tmp_path / 'two.yaml'
    params.write_text('/**:\n  ros__parameters:\n    inputs: [second]\n    second.type: imu\n'
                      '    second.topic: /second\n'
                      '    second.mounting_rpy: [0.0, 0.0, 1.5]\n    second.lever_arm: [-0.5, 0.0, 0.0]\n')
    assert simulate(['--output', str(tmp_path / 'bag'), '--duration', '120', '--rate', '50', '--params-file',
                     str(params)]) == 0
    values = table.check(load_yaml(params))
    # when it is read
    whole, said = read_part(tmp_path / 'bag', values, lambda part: None)
    # then the IMUs are one, which nothing was wrong with
    assert not said and 'second' not in whole.streams()
    alone, _ = read_part(tmp_path / 'bag', table.defaults(), lambda part: None)
    assert len(whole.imu) == len(alone.imu) and (whole.imu.angular_rate != alone.imu.angular_rate).any()
    # and a recording that has one of them only is read with a warning
    for missing, there in (('imu_topic', '/second'), ('second.topic', '/imu/data')):
        given = {**values, missing: '/not/there'}
        one_only, said = read_part(tmp_path / 'bag', given, lambda part: None)
        assert len(one_only.imu) > 2000, there
        assert "no messages of an IMU on '/not/there'" in said[0]


def test_configure_finds_the_second_from_a_bag(tmp_path):
    # given a simulated drive with a second IMU, turned by all three angles
    params = tmp_path / 'two.yaml'
    params.write_text('/**:\n  ros__parameters:\n    inputs: [second]\n    second.type: imu\n'
                      '    second.topic: /second\n'
                      '    second.mounting_rpy: [0.3, -0.2, 1.5]\n    imu.mounting_rpy: [0.0, 0.1, 0.5]\n')
    assert simulate(['--output', str(tmp_path / 'bag'), '--duration', '300', '--standstill', '20',
                     '--params-file', str(params)]) == 0
    found = configure([tmp_path / 'bag']).values
    # then it is set up, mounted as it is to what its biases leave
    assert found['inputs'] == ['second'] and found['second.type'] == 'imu' and found['second.topic'] == '/second'
    off = rotation_from_rpy(*found['second.mounting_rpy']) @ rotation_from_rpy(0.3, -0.2, 1.5).T
    first_off = rotation_from_rpy(*found['imu.mounting_rpy']) @ rotation_from_rpy(0.0, 0.1, 0.5).T
    between = off @ first_off.T
    assert np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1)) < np.radians(2.5)
    assert abs(found['second.time_offset']) < 0.005
    assert table.check(found)


def test_the_same_sensor_twice_is_no_second_one(first, second):
    # given a copy with other stamps, and one of other axes and rates with the same noise
    assert 'the same sensor twice' in compare_imus(first, replace(first, stamp=first.stamp + 3_000_000))
    swapped = replace(first, specific_force=first.specific_force[:, [1, 0, 2]] * [1, -1, 1] + 1e-9,
                      angular_rate=first.angular_rate[:, [1, 0, 2]] * [1, -1, 1] + 1e-9)
    assert 'the same sensor twice' in compare_imus(first, swapped)
    # and an IMU of another vehicle is none either, while one of this one is, by its lag and rotation
    assert 'do not go with' in compare_imus(first, replace(second, angular_rate=np.roll(second.angular_rate, 3000, 0)))
    late = compare_imus(first, replace(second, stamp=second.stamp + 50_000_000))
    assert abs(late.lag - 0.05) < max(5 * late.lag_sigma, 0.002) and late.lag_sigma < 0.01
    true = rotation_from_rpy(*FIRST_MOUNTING).T @ rotation_from_rpy(*TURNED)
    angle = np.arccos(np.clip((np.trace(late.rotation @ true.T) - 1) / 2, -1, 1))
    assert angle < 3 * late.sigma < np.radians(9)


@pytest.mark.parametrize('rate', [20.0, 50.0, 200.0])
def test_one_sample_that_is_off_is_no_noise_at_any_rate(rate):
    # given an IMU whose usual noise is known
    book, rng = book_of(2, VALUES), np.random.default_rng(4)
    for k in range(round(60.0 * rate)):
        keep(book, 0, round(k / rate * 1e9), NOISE * rng.standard_normal(6), 1.0 / rate)
    noisier = []
    # when one of its samples is off by thousands of it, and then more of them are
    for k, value in enumerate((50.0, 0.0, 50.0, -50.0)):
        keep(book, 0, round((60.0 + k / rate) * 1e9), np.full(6, value), 1.0 / rate)
        noisier.append(is_noisier(book, 0, 1))
    # then it does not count as noisier by the first one, which comes and goes, but by more
    assert noisier == [False, False, True, True]
