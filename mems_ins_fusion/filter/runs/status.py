"""Reports of a running filter: its state in words, messages to the user, and values for diagnostics."""
from __future__ import annotations

import math

import numpy as np

from ..measurements import wheel_vibration
from ..memory import NAV, Event, Head, Kind, Nav, Sample, Verdict, newest_row, sample_at
from ..trust import white_noise
from ..trust.drift import Drift
from ..trust.force_noise import force_noise
from ..trust.imu_faults import FAULTS, Fault, Imu
from ..trust.receiver import realised_scatter
from .horizon import Horizon
from .intake import Intake
from .odometry import published_covariance
from .snapshot import vehicle_heading
from .tally import REPORTED
from .vehicle_check import found_mounting, found_time_offsets, mounting_angles

#: the verdicts in words
VERDICTS = {Verdict.USED: 'used', Verdict.WEIGHTED: 'weighted down',
            Verdict.REFUSED: 'does not fit what the filter expects',
            Verdict.FROZEN: 'repeats itself while the vehicle moves',
            Verdict.EXTRAPOLATED: 'extrapolated on a straight line, as without satellites',
            Verdict.AHEAD: 'stamped ahead of the IMU',
            Verdict.CONTRADICTED: 'its integral differs from the displacement between fixes',
            Verdict.AWAITED: 'its integral has not been compared with the fixes yet',
            Verdict.RECOVERED: 'the filter restarted from it'}
#: s for which the state is `recovering` after a new start from refused fixes: the heading is found again in this time
RECOVERING = 10.0
#: realised over expected standard deviation of the innovations above which something is wrong. The largest of 180
#: fault-free drives of 10 minutes was 1.72, and 2 % of them were above 1.5; with fixes stamped 0.8 s early all are
#: above (studies/strain.py)
STRAINED = 1.75
#: m/s^2/sqrt(Hz), noise of the accelerometers that the fixes show, beyond which something is wrong: on measured and
#: simulated drives without faults it is below 0.21
NOISY = 0.25


class FilterStatus(Intake):
    """Base class of the live filter (live.py), which sets the attributes that are read here."""

    @property
    def aligned(self) -> bool:
        """Whether the heading is known. Before, only the position is estimated."""
        return self._memory is not None

    @property
    def has_estimate(self) -> bool:
        """Whether there is an estimate of the position at least."""
        return self._estimating is not None

    @property
    def status(self) -> str:
        """In a few words, what the filter does or what it is waiting for."""
        if self._memory is None:
            tally = self.tallies['fix']
            if tally.steadily(tally.last, patient=False):
                return f'waiting for a fix that can be used: the last {tally.row} were refused ({tally.reason})'
            return f'waiting for {self._alignment.waiting_for}'
        if self._outage:
            return f'outage for {(self._now - self._newest_fix) * 1e-9:.1f} s'
        return '; '.join(self.reasons) or 'running'

    @property
    def contradicted(self) -> bool:
        """Whether the filter cannot start because the inputs contradict the parameters."""
        if self._memory is not None:
            return False
        tally = self.tallies['fix']
        refused = tally.steadily(tally.last, patient=False) and 'without a fix' not in tally.reason and (
            'no fix' not in tally.reason)  # fixes may still come
        return self._alignment.contradicted or refused

    @property
    def reasons(self) -> list[str]:
        """Why the filter is degraded, in words; empty where nothing is wrong."""
        if self._memory is None:
            return []
        now, found = self._now, []
        if now * 1e-9 - self._last_fault < REPORTED:
            found.append(f'samples on {self.config.imu.topic} rejected: {self._fault}')
        for kind, measurement in self.config.inputs.items():
            tally = self.tallies[measurement.name]
            if tally.steadily(now, patient=kind != Kind.POSITION):
                found.append(f'the last {tally.row} messages on {self.topic(kind)} refused: {tally.reason}')
        strain = self._strain()
        if strain > STRAINED:
            found.append(f'innovations {strain:.1f} times as large as expected: a wrong gnss.time_offset, '
                         'gnss.lever_arm or noise (`diagnose` finds which)')
        noise = math.sqrt(force_noise(newest_row(self._memory), 0))
        if noise > NOISY:
            found.append(f'the fixes do not fit the accelerometers, whose noise density seems to be {noise:.1g} '
                         'm/s^2/sqrt(Hz): a wrong gnss.time_offset, a wrong imu.mounting_rpy or a loose IMU '
                         '(`diagnose` finds which)')
        return found

    def _strain(self) -> float:
        """Realised over expected standard deviation of the innovations."""
        return math.sqrt(newest_row(self._memory)[Nav.VARIANCE_FACTOR])

    @property
    def state(self) -> str:
        """waiting, aligning, fusing, coasting, degraded or recovering."""
        if self._memory is None:
            return 'aligning' if self._last[Kind.POSITION] != -1 else 'waiting'
        if self._now * 1e-9 - self._last_recovery < RECOVERING:
            return 'recovering'
        if self._outage:
            return 'coasting'
        return 'degraded' if self.reasons else 'fusing'

    @property
    def _now(self) -> int:
        """Stamp of the newest IMU sample, ns."""
        return int(self._follow[0])

    @property
    def _estimating(self) -> np.ndarray | None:
        """Memory of the filter that is published; None where there is none."""
        return self._provisional if self._memory is None else self._memory

    def _refusal(self, kind: int, verdict: int, stamp: int, event) -> str:
        """Why a measurement was refused, in words and numbers."""
        if verdict == Verdict.FROZEN:
            return f'{self.name(kind)} repeats itself while the vehicle moves: refused'
        if verdict == Verdict.EXTRAPOLATED:
            return 'fixes on a straight line, as of a receiver that extrapolates without satellites: fix refused'
        if verdict == Verdict.CONTRADICTED and self.config.inputs[kind].kind == Kind.HEADING:
            return (f'{self.name(kind)} differs from the direction of travel between fixes, as with antennas that are '
                    f'exchanged or turned ({self.name(kind)}.offset) or iron nearby: refused')
        if verdict == Verdict.CONTRADICTED:
            return (f'{self.name(kind)}: its integral differs from the displacement between fixes, as with a wrong '
                    'unit, sign or axes, or a dead sensor: refused')
        if verdict == Verdict.AHEAD:
            missing = f'IMU samples are missing, {self._last_gap:.1f} s of them' if self._last_gap else (
                'IMU samples come late, as on a busy machine')
            return (f'{self.name(kind)} stamped {(stamp - self._now) * 1e-9:.1f} s after the IMU sample that came '
                    f'next: {missing}, or the clocks differ (gnss.time_offset); refused')
        measurement = self.config.inputs[kind]
        innovation = event[Event.Z_N:Event.Z_N + measurement.components]
        said = f'{measurement.off(event[Event.VALUE], innovation)}, {math.sqrt(event[Event.NIS]):.0f} sigma: refused'
        return f'{said}, as of wheels that slip' if measurement.kind in (Kind.SPEED, Kind.TWIST) else said

    def _say_faults(self, stamp: int) -> None:
        counts = self._memory[Imu.FAULTS:Imu.FAULTS + Fault.SIZE].copy()
        new = counts - np.frombuffer(self._said_faults)
        self._said_faults = counts.tobytes()
        for fault in range(1, Fault.SIZE):
            if new[fault] > 0:
                self._last_fault = stamp * 1e-9
                f = ', '.join(f'{v:.4g}' for v in self._sample[0, 1:4])
                w = ', '.join(f'{v:.4g}' for v in self._sample[0, 4:7])
                self._fault = FAULTS[fault]
                self.tallies['imu'].refuse(stamp, self._fault)
                self.say('warning', f'{self.config.imu.topic}: linear_acceleration ({f}), angular_velocity ({w}): '
                                    f'{FAULTS[fault]}: sample rejected, bridged')

    def _say_new_starts(self) -> None:
        """Report a new start of the published state since the last call, with its reason."""
        row, before = newest_row(self._memory), self._starts
        self._starts = row.item(Nav.RESTARTS), row.item(Nav.RECOVERIES)
        if self._starts == before:
            return
        if self._starts[0] > before[0]:
            self._last_recovery = self._now * 1e-9
            self.say('error', 'the state was not finite: the filter went back to the last good one')
        if self._starts[1] > before[1]:
            self._last_recovery = self._now * 1e-9
            tally = self.tallies['fix']
            why = f'the fixes refused for {(self._now - tally.since) * 1e-9:.0f} s agree with each other'
            if tally.last == 0 or (self._now - tally.last) * 1e-9 > REPORTED:  # none was refused: the IMU is wrong
                why = 'the fixes depart from the filter as a vehicle moves'
            self.say('warning', f'{self.topic(Kind.POSITION)}: {why}: position, velocity and heading restart from them')

    def _say_gap(self, seconds: float) -> None:
        self._last_gap = seconds
        self.gaps += 1
        self.say('warning', f'{self.config.imu.topic}: no sample for {seconds:.2f} s (imu.max_gap): samples are '
                            'missing, bridged')

    def verdicts(self) -> list:
        """What the filter did with each measurement since the last call: a list of `live.Judgement`."""
        judged, self._judged = self._judged, []
        return judged

    def health(self) -> dict:
        """Values for /diagnostics, by name with the unit."""
        values: dict = {'state': self.state, 'status': self.status, 'gaps between IMU samples': self.gaps}
        for name, tally in self.tallies.items():
            values |= {f'{name} used': tally.used} if tally.used else {}
            values |= {f'{name} refused, {reason}': count for reason, count in tally.refused.items()}
        memory = self._estimating
        if memory is None:
            return values
        layout, row = self.config.layout, newest_row(memory)
        sigma = np.sqrt(np.diag(published_covariance(row, layout)))
        values |= {'position sigma, m': float(math.hypot(sigma[0], sigma[1])),
                   'heading sigma, deg': math.degrees(sigma[layout.n_navigation - 1]),
                   'speed, m/s': math.hypot(row[Nav.V_N], row[Nav.V_E]),
                   'speed sigma, m/s': math.sqrt(sigma[layout.index('v_n')]**2 + sigma[layout.index('v_e')]**2)}
        if self._memory is None:
            return values
        horizon = self._horizon.predict(memory, realised=self._withheld.realised)
        values |= {'trust horizon, s': horizon.seconds, 'trust horizon, m': horizon.metres,
                   'trust horizon to, m': self.config.parameters['horizon.limit']}
        values['heading sigma of the vehicle, deg'] = math.degrees(vehicle_heading(self.config, memory)[1])
        values['mounting found'] = found_mounting(memory, self.config) or 'nothing against imu.mounting_rpy'
        values |= {f'{self.name(kind)} time offset found': text
                   for kind, text in found_time_offsets(memory, self.config).items()}
        sample = sample_at(memory, int(memory[Head.SAMPLES]))
        values |= {'age of the last fix used, s': (self._now - self._newest_fix) * 1e-9,
                   'realised over claimed sigma of the fixes': math.sqrt(realised_scatter(row, 0)),
                   'realised over expected sigma of the innovations': self._strain(),
                   'realised over assumed drift of the accelerometers': math.sqrt(row[Drift.RATIO]),
                   'realised over assumed drift of the gyroscopes': math.sqrt(row[Drift.RATIO + 1]),
                   'shown over assumed noise of the accelerometers': math.sqrt(white_noise.shown(memory, sample, 0)),
                   'shown over assumed noise of the gyroscopes': math.sqrt(white_noise.shown(memory, sample, 3)),
                   'contradicted by the constraint, s': float(row[Nav.SLID])}
        values |= wheel_vibration.diagnostics(memory, memory[sample + Sample.TIME])
        for i, name in enumerate(layout.names[layout.n_navigation:], start=layout.n_navigation):
            values[name] = float(row[NAV + i])
            values[f'{name} sigma'] = float(sigma[i])
        if self.datum is not None:
            latitude, longitude = np.degrees(self.datum[:2])
            values['datum'] = f'{latitude:.8f}, {longitude:.8f}, {self.datum[2]:.3f}'
        return values

    def horizon(self) -> Horizon | None:
        """The trust horizon (`Horizon`): time and distance within `horizon.limit` without fixes; None before the
        heading is known."""
        return None if self._memory is None else self._horizon.predict(self._memory,
                                                                       realised=self._withheld.realised)

    def vehicle_axes(self) -> tuple[float, float, float | None]:
        """Estimated rotation of the vehicle's axes from those of imu.mounting_rpy: to the right, then up, rad; and the
        standard deviation of the vehicle's heading, rad, None before the heading is known."""
        if self._memory is None:
            return 0.0, 0.0, None
        return (*mounting_angles(newest_row(self._memory), self.config.layout),
                vehicle_heading(self.config, self._memory)[1])
