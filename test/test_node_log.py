"""The parts of the nodes that need no ROS: what is logged, when a topic counts as silent, what is lost."""
import time
from types import SimpleNamespace

import pytest

from mems_ins_fusion.nodes.inputs import Queue, stamp_of
from mems_ins_fusion.nodes.log import LONGEST_HOLD, SilenceWatch, StateLog, Throttle
from mems_ins_fusion.nodes.traffic import Traffic


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_the_same_complaint_with_other_numbers_is_held_back_and_counted(clock):
    # given a NaN in each of 400 messages a second
    throttle = Throttle(5.0, clock)
    passed = []
    for sample in range(2401):
        clock.now = 100.0 + sample / 400
        passed.append(throttle.pass_on(f'/imu/data: angular_velocity.x is nan at 17617{sample}.5e-3: sample dropped'))
    # then two lines in six seconds, and no complaint is forgotten
    lines = [line for line in passed if line]
    assert len(lines) == 2
    assert lines[0].endswith('sample dropped')
    assert lines[1].endswith('sample dropped (1999 more like this before)')


def test_another_complaint_is_not_held_back(clock):
    throttle = Throttle(5.0, clock)
    assert throttle.pass_on('/imu/data: angular_velocity.x is nan')
    assert throttle.pass_on('/imu/data: angular_velocity.y is nan')
    assert throttle.pass_on('/gps/fix: latitude is nan')


def test_a_silent_topic_is_noticed_after_its_patience_then_periodically_then_its_return(clock):
    watch = SilenceWatch(patience=3.0, period=30.0, clock=clock)
    found = {}
    for second in range(1, 41):
        clock.now = 100.0 + second
        found[second] = watch.check()
    # when a message arrives
    watch.count += 1
    clock.now = 141.0
    ended = watch.check()
    # then silence was reported at 3 s and 30 s later, and its end once
    assert {second: said for second, said in found.items() if said} == {3: (True, 3.0), 33: (True, 33.0)}
    assert ended == (False, 41.0)
    clock.now = 142.0
    assert watch.check() is None


def test_a_topic_that_speaks_is_never_silent(clock):
    watch = SilenceWatch(patience=3.0, clock=clock)
    for second in range(1, 20):
        clock.now = 100.0 + second
        watch.count += second % 2
        assert watch.check() is None


def test_rates_are_those_of_a_recording_that_is_played_five_times_as_fast(clock):
    # given messages of 100 Hz by their stamps, of which 500 come in each second
    traffic, hertz = Traffic(3.0, now=lambda: 0, clock=clock), []
    for second in range(1, 4):
        clock.now, traffic.count, traffic.stamp = 100.0 + second, 500 * second, 10**18 + 5 * second * 10**9
        traffic.look(1)
        hertz.append(traffic.hertz)
    assert hertz == [0.0, 100.0, 100.0]
    # and when their clock is set back, the rate is the last one known; when none come, there is none
    traffic.count, traffic.stamp = 1600, 10**18
    traffic.look(1)
    assert traffic.hertz == 100.0
    traffic.look(1)
    assert traffic.hertz == 0.0


def test_a_state_that_lasts_is_said_again_but_for_the_good_one(clock):
    log, said = StateLog(period=30.0, clock=clock), {}
    for second in range(200):
        clock.now = 100.0 + second
        state = 'waiting' if second < 70 else 'fusing'
        lasted, line = log.look(state, 'waiting for a fix on /gps/fix' if state == 'waiting' else 'running')
        if line:
            said[second] = line
    assert lasted == 129.0
    assert said == {0: 'state: waiting for a fix on /gps/fix',
                    30: 'state: still waiting for a fix on /gps/fix, for 30 s',
                    60: 'state: still waiting for a fix on /gps/fix, for 60 s',
                    70: 'state: fusing after waiting for 70 s (running)'}


def test_what_keeps_on_coming_is_let_through_ever_more_seldom(clock):
    throttle, passed = Throttle(5.0, clock), []
    for k in range(6000):  # ten minutes
        clock.now = 100.0 + k / 10
        if throttle.pass_on(f'waiting for the vehicle to move: {k}'):
            passed.append(k / 10)
    assert len(passed) < 15 and max(b - a for a, b in zip(passed, passed[1:])) == pytest.approx(LONGEST_HOLD)
    # and one that was away for long is said at once, and soon again
    clock.now += 3 * LONGEST_HOLD
    assert throttle.pass_on('waiting for the vehicle to move: 1')
    clock.now += 5.0
    assert throttle.pass_on('waiting for the vehicle to move: 2')


def header(stamp):
    return SimpleNamespace(stamp=SimpleNamespace(sec=stamp, nanosec=0), frame_id='imu')


def test_what_is_missing_between_the_numbers_of_a_publisher_is_lost(clock):
    traffic = Traffic(3.0, now=lambda: 12 * 10**9, clock=clock)
    now = time.time_ns()
    for number in (7, 8, 9, 15, 16):
        traffic.take(header(10), {'publication_sequence_number': number, 'source_timestamp': now})
    missing, _ = traffic.look(1)
    assert missing == traffic.lost == 5 and traffic.count == 5
    assert traffic.delay == pytest.approx(2.0) and traffic.frame_id == 'imu'
    # the numbers of another publisher, or of two, say nothing
    for number in (3, 4, 900, 5, 901):
        traffic.take(header(11), {'publication_sequence_number': number, 'source_timestamp': now})
    assert traffic.look(2)[0] == 0 and traffic.lost == 5
    # nor where there are none
    traffic.take(header(11), {'publication_sequence_number': None, 'source_timestamp': now})
    assert traffic.look(1)[0] == 0


def test_how_late_a_message_is_does_not_depend_on_the_clock_of_its_publisher(clock):
    traffic, hour = Traffic(3.0, now=lambda: 0, clock=clock), 3600 * 10**9
    traffic.take(header(10), {'publication_sequence_number': 1, 'source_timestamp': time.time_ns() + hour})
    waited = traffic.take(header(10), {'publication_sequence_number': 2,
                                       'source_timestamp': time.time_ns() + hour - 700_000_000})
    assert 0.69 < waited < 5.0
    assert traffic.look(1)[1] == pytest.approx(waited)


def test_a_state_that_gets_worse_is_said_at_once(clock):
    log, said = StateLog(period=30.0, clock=clock), {}
    for second in range(40):
        clock.now = 100.0 + second
        line = log.look('aligning', 'waiting for units', 0 if second < 6 else 1 if second < 20 else 2)[1]
        if line:
            said[second] = line
    assert list(said) == [0, 6, 20]


class Topic:
    """An input of a queue: `wait` what has not been taken yet, `got` names and stamps of what was served, ns."""

    def __init__(self, name, got):
        self.name, self.is_imu, self.wait, self.got = name, name == 'imu', [], got
        self.traffic = SimpleNamespace(stamp=0, waited=lambda info: info['late'])

    def take(self):
        return self.wait.pop(0) if self.wait else None

    def on_message(self, message, info):
        self.traffic.stamp = stamp_of(message)
        self.got.append((self.name, self.traffic.stamp))


def sent(stamp, late):
    """A message that was sent at its stamp, ns, and has come `late` s later than others."""
    message = SimpleNamespace(header=header(0))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message, {'source_timestamp': stamp, 'late': late}


def test_what_waits_is_served_in_the_order_in_which_it_was_sent_and_what_overtook_samples_waits_with_all_after_it():
    queue, got, tenth = Queue(SimpleNamespace(create_guard_condition=lambda callback: None)), [], 10**8
    imu, fix = Topic('imu', got), Topic('fix', got)
    queue.inputs += [imu, fix]
    # when a message is served, all that wait go with it
    imu.wait, fix.wait = [sent(k * tenth, 3.0) for k in (102, 104, 105)], [sent(103 * tenth, 3.0)]
    queue.serve(imu, *sent(101 * tenth, 3.0))
    assert got == [(name, k * tenth) for name, k in zip(('imu', 'imu', 'fix', 'imu', 'imu'), range(101, 106))]
    # when two fixes come without the samples of before them, the first of them late
    fix.wait = [sent(130 * tenth, 0.0)]
    queue.serve(fix, *sent(120 * tenth, 3.0))
    assert got[5:] == []
    # then they are served in their order behind those
    imu.wait = [sent(119 * tenth, 3.0), sent(131 * tenth, 0.0)]
    queue.release()
    assert got[5:] == [(name, k * tenth) for name, k in (('imu', 119), ('fix', 120), ('fix', 130), ('imu', 131))]
