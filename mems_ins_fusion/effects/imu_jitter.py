"""Unevenly stamped IMU samples: the stamps are times of arrival, not of measurement."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, Sighting
from mems_ins_fusion.effects.imu_repeats import wider_noise

#: in sampling intervals: smallest standard deviation of the intervals that is reported
SMALLEST = 0.1
#: in sampling intervals: a longer interval is a gap and does not count
_GAP = 5.0
#: ns, difference of the stamps of simulated samples that arrive together
_CLOSEST = 50_000


class ImuJitter(Effect):
    """Samples are stamped late by random times: exponentially distributed with mean `sigma`, s, in their order."""

    name = 'imu_jitter'
    signature = ('no clear one: the sensors are noisier than characterized; fixes seem early by the mean '
                 'delay')
    in_words = 'IMU samples are stamped unevenly'
    to_check = 'whether the driver can stamp with the sensor\'s own clock'
    parameters = (EffectParameter('sigma', 's', 5e-3),)
    traced = ()

    def distort_samples(self, imu, values, rng):
        late = np.round(1e9 * values['sigma'] * rng.standard_exponential(len(imu))).astype(np.int64)
        order = _CLOSEST * np.arange(len(imu)) * (values['sigma'] > 0)
        stamp = np.maximum.accumulate(imu.stamp + late - order) + order
        return replace(imu, stamp=stamp, received=np.maximum(imu.received, stamp))

    def seen(self, values, recording):
        step = np.diff(recording.imu.stamp)
        step = step[step > 0] * 1e-9
        if len(step) < 100:
            return None
        interval = (np.percentile(step, 25) + np.percentile(step, 75)) / 2
        step = step[step < _GAP * interval]
        scatter = float(step.std())
        if scatter < SMALLEST * interval:
            return None
        sigma = scatter / np.sqrt(2)
        # samples come in order: a late one delays those after it, and intervals scatter by less than delays
        held_back = 0.5 * (sigma / interval)**2
        return Sighting({'sigma': (float(sigma), float(sigma * np.hypot(held_back, len(step)**-0.5)))},
                        f'the intervals between IMU samples, {1e3 * interval:.3g} ms, scatter by '
                        f'{1e3 * scatter:.2g} ms: they are stamped on arrival. Let the driver stamp with the clock '
                        'of the sensor; until then all other sensors seem early by about as much',
                        wider_noise(values, recording.imu, (sigma / interval)**2))
