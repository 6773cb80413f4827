"""Absurd messages to the live node over real ROS: does it live on, and is all that it publishes a number?

    python studies/node_fuzz.py [--runs 4] [--seed 0] [--seconds 150] [--share 0.03] [--speed 3] [-p NAME:=VALUE ...]

Each run is a simulated drive with every input that a node can have, published at `--speed` times its own pace, of which
a share of the messages is spoiled: numbers that no sensor sends (NaN, infinite, 1e300, 5e-324, one where another
quantity stands), stamps of another year, negative or twice, arrays full of them, names that are empty or endless. In
the last third nothing is spoiled. An IMU sample is spoiled a tenth as often, as there are so many. Told for each run:
whether the node lived until it was stopped, ended with status 0 and without a traceback, published nothing but numbers,
and what it says at the end; exit status 1 where not the first three.
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path
from signal import SIGINT

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from ros_support import PATIENCE, PLAYABLE, Diagnostics, NodeProcess, Peer, Player, hears  # noqa: E402

from mems_ins_fusion.simulation.drive import simulate_drive  # noqa: E402
from mems_ins_fusion.simulation.simulation import (  # noqa: E402
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_recording,
)

INPUTS = 'speed', 'velocity', 'heading', 'pressure', 'twist', 'magnetometer'
RATES = SimulatedAiding(**{f'{name}_rate': 5.0 for name in INPUTS})
REALS = (float('nan'), float('inf'), -float('inf'), 0.0, -0.0, 1e300, -1e300, 1e155, 5e-324, 1e18, -1.0, 9.81, 90.0,
         1e5, -400.0)
WORDS = '', ' ', '/', '\u00e4\u00f6\n', 'x' * 100_000, '%s', '{0}', '../..'
#: of the drive, s: what is published before the listener spins
STEP = 0.2
CLEAN = 1.0 / 3.0  # part of the drive, at its end, in which nothing is spoiled
IMU_SHARE = 0.1  # how often an IMU sample is spoiled, over other messages


def drive(seed: int, seconds: float):
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    return simulate_recording(simulate_drive(seconds, seed=seed, rate=50.0, standstill=6.0), sensors,
                              GnssNoise(sigma=0.5, rate=2.0), seed=seed, aiding=RATES).recording


def spoil(message, rng: np.random.Generator) -> None:
    """Make one field of `message` absurd, or one of what is in it, or all numbers of an array."""
    fields = list(message.get_fields_and_field_types().items())
    name, kind = fields[rng.integers(len(fields))]
    value = getattr(message, name)
    if hasattr(value, 'get_fields_and_field_types'):
        spoil(value, rng)
    elif kind == 'string':
        setattr(message, name, str(rng.choice(WORDS)))
    elif kind in ('double', 'float'):
        setattr(message, name, float(rng.choice(REALS)))
    elif isinstance(value, np.ndarray):
        where = slice(None) if rng.random() < 0.5 else int(rng.integers(len(value)))
        value[where] = rng.choice(REALS)
    elif isinstance(value, int):
        setattr(message, name, int(rng.choice(_integers(kind))))


def _integers(kind: str) -> tuple[int, ...]:
    bits = int(''.join(c for c in kind if c.isdigit()) or 8)
    return (0, 1, 7, 2**bits - 1) if kind.startswith('u') else (0, 1, -1, 2 ** (bits - 1) - 1, -(2 ** (bits - 1)))


def numbers(message) -> np.ndarray:
    """All real numbers of a message."""
    found = []
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            found.append(numbers(value))
        elif 'double' in kind or 'float' in kind:
            found.append(np.ravel(value))
    return np.concatenate([np.zeros(0), *found])


def run(seed: int, options: argparse.Namespace) -> list[str]:
    """What went wrong in one run."""
    rng, recording, failed = np.random.default_rng(seed), drive(seed, options.seconds), []
    end = (1.0 - CLEAN) * options.seconds
    spoiled = dict.fromkeys(('imu', 'fix', *INPUTS), 0)

    def change(name, i, message):
        share = options.share * (IMU_SHARE if name == 'imu' else 1.0)
        if player.now < end and rng.random() < share:
            spoiled[name] += 1
            for _ in range(rng.integers(1, 4)):
                spoil(message, rng)

    extra = [part for one in options.parameter for part in ('-p', one)]
    peer = Peer()
    with NodeProcess('fusion_node', *PLAYABLE, *hears(*INPUTS), *extra) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, change)
        player.now = -1.0
        player.connect(*INPUTS)
        for now in np.arange(0.0, options.seconds, STEP):
            player.now = now
            player.play(until=now + STEP, in_step=False)
            peer.spin_some(STEP / options.speed)
        peer.spin_some(5.0)
        state = heard.message('filter')
        if node.status is None:
            node.send(SIGINT)
        else:
            failed.append('the node died')
        status = node.wait(PATIENCE)
        if status:
            failed.append(f'the node ended with status {status}')
        failed += [line for line in node.lines if 'Traceback' in line or 'Warning:' in line]
        lines = list(node.lines)
    for what, messages in (('odometry', peer.odometry), ('fused fix', peer.fixes)):
        wrong = sum(not np.isfinite(numbers(message)).all() for message in messages)
        if wrong:
            failed.append(f'{wrong} of {len(messages)} messages of the {what} hold what is not a number')
    last = max((m.header.stamp.sec for m in peer.odometry), default=0)
    print(f'seed {seed}: spoiled {sum(spoiled.values())} ({", ".join(f"{k} {v}" for k, v in spoiled.items())}), '
          f'{len(peer.odometry)} odometry messages, the last one '
          f'{int(recording.imu.stamp[-1] // 10**9) - last} s before the end; at the end: {state[:100]}', flush=True)
    if failed or options.log:
        print('\n'.join(lines if options.log else lines[-40:]))
    peer.close()
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=4)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--seconds', type=float, default=150.0)
    parser.add_argument('--share', type=float, default=0.03, help='of the messages, spoiled')
    parser.add_argument('--speed', type=float, default=3.0)
    parser.add_argument('--log', action='store_true', help='print all lines of the node')
    parser.add_argument('-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE')
    options = parser.parse_args()
    failures = 0
    for seed in range(options.seed, options.seed + options.runs):
        failed = run(seed, options)
        failures += bool(failed)
        for line in failed:
            print(f'seed {seed}: {line}', flush=True)
    print(f'{options.runs} runs, {failures} failed')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
