"""What the node says soon after its start of the clocks of its inputs."""
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.nodes import preflight
from mems_ins_fusion.nodes.preflight import Preflight
from mems_ins_fusion.nodes.traffic import Traffic
from mems_ins_fusion.parameters import table

SECOND = 10**9
STARTED = 1_500_000_000 * SECOND  # ns: the recording is years older than the node


class Played:
    """A recording of 100 Hz and 4 Hz whose messages come `rate` times as fast as they were recorded.

    newer: s, by which a fix is stamped after the newest sample when it comes. After 6 s by the clock it has been seen.
    silent: s, whole ones, before the first message. publishers: of each topic. has_position: whether fixes have one.
    said: texts.
    """

    def __init__(self, monkeypatch, rate, newer, silent=0, publishers=1, has_position=True, **values):
        self.now = 100.0
        monkeypatch.setattr(preflight.time, 'monotonic', lambda: self.now)
        inputs = [SimpleNamespace(name=name, topic_name=f'/{name}', kind='a type', qos_problem=lambda: '',
                                  publishers=lambda: publishers, why_silent=lambda: 'nobody publishes it',
                                  traffic=Traffic(3.0, lambda: STARTED + 10**17 + round(self.now * SECOND),
                                                  clock=lambda: self.now)) for name in ('imu', 'fix')]
        looks = Preflight(inputs, {**table.defaults(), **values})
        told = []
        for second in range(silent):
            self.now = 100.0 + second
            told.append(looks.look(None))
        for k in range(round(700 * rate)):
            self.now = 100.0 + silent + k / (100 * rate)
            self._take(inputs[0], k / 100)
            if k % 25 == 7:
                looks.add_fix(self._take(inputs[1], k / 100 + newer), has_position)
            if k % round(100 * rate) == 0:
                for one in inputs:
                    one.traffic.look(1)
                told.append(looks.look(None))
        self.said = [one[1] for one in told if one is not None]
        self.clocks = next(line for line in self.said[-1].splitlines() if line.strip().startswith('clocks'))

    @staticmethod
    def _take(told, seconds) -> int:
        stamp = STARTED + round(seconds * SECOND)
        parts = SimpleNamespace(sec=stamp // SECOND, nanosec=stamp % SECOND)
        told.traffic.take(SimpleNamespace(stamp=parts, frame_id=told.name),
                          {'publication_sequence_number': None, 'source_timestamp': 0})
        return stamp


@pytest.mark.parametrize('rate', [0.5, 1.0, 8.0])
def test_a_time_offset_that_is_given_is_not_asked_for_at_any_speed_of_the_recording(monkeypatch, rate):
    # given a drive whose fixes come with stamps of the newest sample, and whose time offset is known
    played = Played(monkeypatch, rate, newer=0.006, **{'gnss.time_offset': -0.266})
    # then what is said is the stamps as they are and as they are used, and nothing is asked for
    assert "0.006 s newer than the IMU's" in played.clocks
    assert '0.272 s newer with gnss.time_offset -0.266 s' in played.clocks
    assert played.clocks.endswith(': fine')


@pytest.mark.parametrize('rate', [1.0, 8.0])
@pytest.mark.parametrize('newer, is_fine', [(-0.25, True), (0.05, True), (0.3, False), (-1.4, False)])
def test_clocks_that_differ_are_told_without_a_time_offset_at_any_speed(monkeypatch, rate, newer, is_fine):
    played = Played(monkeypatch, rate, newer)
    assert f'{abs(newer):g} s {"newer" if newer > 0 else "older"} than' in played.clocks
    assert played.clocks.endswith(': fine') == is_fine
    assert ('set gnss.time_offset' in played.clocks) != is_fine


def test_a_time_offset_with_which_fixes_are_refused_is_told(monkeypatch):
    # given receiver stamps that are 3 s behind, and an offset of the wrong sign
    right = Played(monkeypatch, 1.0, newer=-3.0, **{'gnss.time_offset': -3.0})
    wrong = Played(monkeypatch, 1.0, newer=-3.0, **{'gnss.time_offset': 3.0})
    assert right.clocks.endswith(': fine')
    assert 'refused' in wrong.clocks and 'wrong in sign' in wrong.clocks


def test_without_a_fix_there_is_nothing_to_compare(monkeypatch):
    # given fixes of which none has come before the first sample
    inputs = [SimpleNamespace(name=name, topic_name=f'/{name}', kind='a type', why_silent=lambda: 'nobody publishes it',
                              traffic=SimpleNamespace(count=0, stamp=0, delay=math.nan)) for name in ('imu', 'fix')]
    now = [0.0]
    monkeypatch.setattr(preflight.time, 'monotonic', lambda: now[0])
    looks = Preflight(inputs, table.defaults())
    looks.add_fix(STARTED, True)
    now[0] = 13.0
    assert 'nothing to compare' in looks.look(None)[1]


@pytest.mark.parametrize('silent', [0, 9, 11, 30])
def test_messages_that_begin_later_are_judged_when_they_have_come_for_some_seconds(monkeypatch, silent):
    # given a node that is started before its drivers, or before a recording is played
    played = Played(monkeypatch, 1.0, 0.0, silent)
    # then what comes in is told once, with its rate, and before that, once, where nothing has come for long
    assert len(played.said) == (2 if silent > preflight.AT_THE_LATEST else 1)
    assert 'no message' not in played.said[-1] and 'needs 20 Hz' not in played.said[-1]
    assert '100 Hz' in played.said[-1]
    assert all('no message' in text for text in played.said[:-1])


def test_two_publishers_of_a_topic_are_told(monkeypatch):
    # given a driver and a recording on the same topics, then it is said; with one publisher it is not
    assert '2 publishers on this topic' in Played(monkeypatch, 1.0, 0.0, publishers=2).said[-1]
    assert 'publishers' not in Played(monkeypatch, 1.0, 0.0).said[-1]


def test_a_receiver_without_a_position_is_not_fine(monkeypatch):
    # given messages that all say that there is no fix, then the block says so; a position is enough to be fine
    said = Played(monkeypatch, 1.0, 0.0, has_position=False).said[-1]
    assert 'the receiver has no position yet' in said and '1 to look at' in said
    assert 'no position' not in Played(monkeypatch, 1.0, 0.0).said[-1]


@pytest.mark.parametrize('mechanization, size, advice', [
    ('strapdown', 9.9, ''), ('strapdown', 40.0, 'a wrong unit'), ('planar', 0.2, ''), ('planar', 2.0, ''),
    ('strapdown', 1.0, "in g; set imu.acceleration_unit to 'g', or the driver has removed gravity"),
    ('strapdown', 0.2, 'a wrong unit or scale, or the driver has removed gravity'),
    ('planar', 1.0, "in g; set imu.acceleration_unit to 'g'"), ('planar', 5.0, 'a wrong unit'),
    ('planar', 40.0, 'a wrong unit')])
def test_an_imu_without_gravity_is_told_where_gravity_is_needed(mechanization, size, advice):
    # given samples of a driver that removes gravity, then neither is another unit the only advice, nor one of mounting
    said = preflight._units(np.array([0.0, 0.0, size]), mechanization)[1]
    assert said.startswith(advice) and bool(said) == bool(advice)
    assert ('has removed gravity' in said) == (mechanization == 'strapdown' and size < 6.0)
