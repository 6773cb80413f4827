"""What the tests of the fleet share: recordings of a year, drives, and ways to run the tool."""
from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mems_ins_fusion.__main__ import main
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.several import shifted_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import ImuSamples, Recording
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

REPOSITORY = Path(__file__).resolve().parents[1]
DAY = 86_400 * 10**9
LATE = 0.3  # s
REST_SAMPLES, REST_DENSITY = 4000, 0.002  # of write_at_rest; m/s^2/sqrt(Hz)
SENSORS = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
PARAMS = """\
/**:
  ros__parameters:
    models: [gauss_markov]
    update_intervals: [1.0]
    outage_durations: [10.0]
    reference_topic: /reference/fix
"""


def write_year(folder: Path, vehicles: int, drives: int) -> None:
    """Recordings of a year of some vehicles: folder/logs/car_N/drive_N, 60 s at 20 Hz each, and params.yaml. One of
    them breaks off; beside them stand an empty file, one that is no recording, and a copy."""
    logs = folder / 'logs'
    for vehicle in range(vehicles):
        for drive in range(drives):
            seed = 100 * vehicle + drive
            driven = simulate_drive(60.0, seed=seed, rate=20.0, standstill=5.0)
            recording = simulate_recording(driven, SENSORS, seed=seed).recording
            reference = recording.reference.select(slice(None, None, 5))
            moved = shifted_recording(recording, 70 * drive * DAY)
            reference = replace(reference, stamp=reference.stamp + 70 * drive * DAY)
            write_recording(replace(moved, reference=reference), logs / f'car_{vehicle}' / f'drive_{drive}')
    broken = next((logs / 'car_1' / 'drive_3').glob('*.mcap'))
    os.truncate(broken, int(0.6 * broken.stat().st_size))
    (logs / 'car_1' / 'empty.mcap').touch()
    (logs / 'car_1' / 'letter.mcap').write_text('this is no recording')
    shutil.copytree(logs / 'car_0' / 'drive_1', logs / 'car_0' / 'moved' / 'drive_1')
    (folder / 'params.yaml').write_text(PARAMS)


def write_late(path: Path, seed: int, backwards: bool = False) -> None:
    """A drive with good fixes that are LATE, long enough to show that they are not smoothed; backwards: by an IMU that
    is mounted so."""
    drive = simulate_drive(150.0, seed=seed, rate=20.0, standstill=5.0)
    recording = simulate_recording(
        drive, SENSORS, GnssNoise(sigma=0.5), [(EFFECTS['gnss_time_offset'], {'time_offset': LATE})],
        [0.0, 0.0, np.pi] if backwards else [0.0, 0.0, 0.0], seed=seed).recording
    write_recording(replace(shifted_recording(recording, seed * DAY), reference=None), path)


def write_at_rest(path: Path, day: int, factor: float = 1.0) -> None:
    """200 s at rest, as a bag or .npz; factor: on the noise of the accelerometers."""
    rng, rate, count = np.random.default_rng(day), 20.0, REST_SAMPLES
    force = factor * REST_DENSITY * np.sqrt(rate) * rng.standard_normal((count, 3)) + [0.0, 0.0, 9.81]
    turn = 1e-3 * rng.standard_normal((count, 3))
    if path.suffix == '.npz':
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, acc_mps2=force, gyro_radps=turn, rate_hz=rate)
        return
    stamp = 1_700_000_000 * 10**9 + day * DAY + np.arange(count) * round(1e9 / rate)
    write_recording(Recording(path.name, ImuSamples(stamp, stamp, force, turn)), path)


def command(*words, dask: bool = False) -> list[str]:
    """What starts `fleet` in a process of its own, by Dask or by a pool of processes as where Dask is not installed."""
    hide = '' if dask else 'sys.modules["distributed"] = None; '
    code = f'import sys; {hide}from mems_ins_fusion.__main__ import main; sys.exit(main(sys.argv[1:]))'
    return [sys.executable, '-c', code, 'fleet', *map(str, words)]


def environment() -> dict[str, str]:
    return {**os.environ, 'PYTHONPATH': f'{REPOSITORY}:{REPOSITORY / "test"}'}


def run(folder: Path, *words, dask: bool = False) -> subprocess.CompletedProcess:
    return subprocess.run(command(*words, dask=dask), cwd=folder, capture_output=True, text=True, env=environment(),
                          timeout=600)


class Here:
    """An engine that does the work in this process, for tests of what is done and not of who does it."""

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *exception) -> None:
        pass

    def each(self, function, items):
        for item in list(items):
            yield item, function(item)


def run_here(folder: Path, *words) -> tuple[int, str, str]:
    """`fleet` in this process, started in `folder`: its exit status and what it said."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        patch.setattr('mems_ins_fusion.fleet.run.engine', lambda *_: Here())
        status = main(['fleet', *map(str, words)])
    return status, out.getvalue(), err.getvalue()


def files(folder: Path) -> dict[str, bytes]:
    """What is in a folder, by path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob('*')) if path.is_file()}


def estimates(rng: np.random.Generator, vehicles: int, drives: int, sigma: float, realised: float = 1.0,
              step: tuple[int, int, float] | None = None) -> list[dict]:
    """Rows of a history: the antenna's place by many drives, each `realised` times as far off as its sigma says. step:
    vehicle, first drive after it, m."""
    rows = []
    for vehicle in range(vehicles):
        place = rng.normal(0.0, 1.0)
        for drive in range(drives):
            moved = step[2] if step and vehicle == step[0] and drive >= step[1] else 0.0
            rows.append({'vehicle': f'car_{vehicle}', 'source': 'diagnose', 'effect': 'gnss_lever_arm',
                         'parameter': 'x', 'sigma': sigma,
                         'stamp_ns': drive * 7 * DAY,
                         'value': place + moved + realised * sigma * rng.standard_normal()})
    return rows
