"""A year of a fleet whose changes are known: are these found, and nothing else?

    python studies/fleet.py --task diagnose             # the whole proof: about an hour on two cores
    python studies/fleet.py --task configure --duration 300
    python studies/fleet.py --estimates --duration 300 --rate 25 --moved 2.5 --vehicles 0 1 6 --drives 20

--estimates: without bags and the tool, only what `configure` sees in each drive and the change points in that.
Eight vehicles, five drives each over a year, simulated: in car_2 the receiver's stamps are 0.3 s off from the start, in
car_4 the antenna is 0.8 m ahead of where the parameters have it, in car_6 it is moved by --moved m after 3 of 5 drives.
One recording breaks off; beside them are an empty file, one that is no recording, and a copy. Printed: the changes
found, and the estimates of the three vehicles.
"""
from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from mems_ins_fusion.configuration.configure import evidence_of_recording
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.fleet import tables
from mems_ins_fusion.fleet.change_points import find_changes, series_of
from mems_ins_fusion.fleet.work import configured_effects
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.several import shifted_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_drive, simulate_recording

DAY = 86_400 * 10**9
BETWEEN = 73 * DAY
ALL = list(range(8))
TIME_OFFSET, ARM = 0.3, 0.8  # s, m


def effects_of(vehicle: int, part: float, moved: float) -> list:
    """What is in a drive that no parameter knows of. part: of the year, 0 to 1."""
    def effect(name, **given):
        return [(EFFECTS[name], EFFECTS[name].complete(given))]

    if vehicle == 2:
        return effect('gnss_time_offset', time_offset=TIME_OFFSET)
    if vehicle == 4:
        return effect('gnss_lever_arm', x=ARM)
    if vehicle == 6 and part >= 0.6:
        return effect('gnss_lever_arm', x=moved)
    return []


def drives(vehicles: list[int], count: int, duration: float, rate: float, moved: float):
    """(vehicle, number, recording) of each drive, without a reference."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    for vehicle in vehicles:
        for drive in range(count):
            seed = 1000 + 100 * vehicle + drive
            made = simulate_recording(simulate_drive(duration, seed=seed, rate=rate), sensors,
                                      effects=effects_of(vehicle, drive / count, moved), seed=seed).recording
            yield vehicle, drive, replace(shifted_recording(made, drive * BETWEEN), reference=None)


def changes_in_estimates(options) -> None:
    """What `configure` sees of the antenna in each drive, and what is taken for a change in that."""
    rows = []
    for vehicle, drive, recording in drives(options.vehicles, options.drives, options.duration, options.rate,
                                            options.moved):
        seen = configured_effects(evidence_of_recording(recording.name, recording.imu, recording.gnss))
        rows += [row | {'vehicle': f'car_{vehicle}', 'stamp_ns': int(recording.imu.stamp[0])} for row in seen]
        print(f'car_{vehicle} drive {drive}:', *(f"{row['parameter']} {row['value']:.2f} +- {row['sigma']:.2f} m"
                                                 for row in seen if row['effect'] == 'gnss_lever_arm'), flush=True)
    for change in find_changes(series_of(rows)):
        print(change.vehicle, change.words(), f'p {change.p:.1g}')


def write(folder: Path, vehicles: list[int], count: int, duration: float, rate: float, moved: float) -> None:
    """The recordings, below folder/logs, and what is wrong among them where all vehicles are there."""
    for vehicle, drive, recording in drives(vehicles, count, duration, rate, moved):
        write_recording(recording, folder / 'logs' / f'car_{vehicle}' / f'drive_{drive}')
    if vehicles != ALL:
        return
    broken = next((folder / 'logs/car_1/drive_3').glob('*.mcap'))
    broken.write_bytes(broken.read_bytes()[:int(0.6 * broken.stat().st_size)])
    (folder / 'logs/car_1/empty.mcap').touch()
    (folder / 'logs/car_1/letter.mcap').write_text('this is no recording')
    shutil.copytree(folder / 'logs/car_0/drive_1', folder / 'logs/car_5/copy_of_another')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--task', choices=('configure', 'diagnose'), default='configure')
    parser.add_argument('--duration', type=float, default=600.0)
    parser.add_argument('--rate', type=float, default=50.0)
    parser.add_argument('--moved', type=float, default=0.6)
    parser.add_argument('--vehicles', type=int, nargs='+', default=ALL)
    parser.add_argument('--drives', type=int, default=5)
    parser.add_argument('--workers', default='2')
    parser.add_argument('--estimates', action='store_true')
    options = parser.parse_args()
    if options.estimates:
        changes_in_estimates(options)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder, options.vehicles, options.drives, options.duration, options.rate, options.moved)
        subprocess.run([sys.executable, '-m', 'mems_ins_fusion', 'fleet', 'logs', '--task', options.task, '--no-pages',
                        '--workers', options.workers, '--output', 'out'], cwd=folder, check=True)
        begins = {r['recording_id']: r['begin_ns'] for r in tables.read(folder / 'out', 'recordings')}
        for row in tables.read(folder / 'out', 'findings'):
            if row['source'] == 'watchman':
                print(row['vehicle'], row['message'])
        for row in tables.read(folder / 'out', 'effects'):
            told = (row['effect'], row['parameter']) in (('gnss_time_offset', 'time_offset'), ('gnss_lever_arm', 'x'))
            if row['vehicle'] in ('car_2', 'car_4', 'car_6') and told:
                day = '' if begins.get(row['recording_id']) is None else (begins[row['recording_id']] // DAY) % 1000
                sigma = 0.0 if row['sigma'] is None else row['sigma']
                print(f"{row['vehicle']} day {day!s:>4} {row['source']:<10} {row['effect']:<17} {row['value']:>7.3f} "
                      f'+- {sigma:.3f}')


if __name__ == '__main__':
    main()
