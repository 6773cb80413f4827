"""What an effect is: something that real vehicles and sensors do and that the filter's model may lack."""
from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    unit: SI, '-' for a ratio. prior_scale: a size that would surprise nobody in the field, in that unit.
    default: its value in a simulation that names only other parameters of the effect.
    """

    name: str
    unit: str
    prior_scale: float
    default: float = 0.0


class Effect:
    """One effect; each module of this package holds one and changes only the hooks it needs.

    The simulated half follows. `drive` is a `recordings.drive.Drive`, `values` the effect's parameters by name, `rng`
    random numbers of the effect's own, started anew for each hook. Specific forces and angular rates are (n, 3) in body
    axes `b`, in m/s^2 and rad/s, means over the interval before `drive.time`; times are s after the start of the drive.
    """

    name: str = ''
    parameters: tuple[EffectParameter, ...] = ()

    @property
    def principal(self) -> str:
        """The parameter that is meant where a user gives one value for the effect."""
        return self.parameters[0].name

    def complete(self, values: dict) -> dict:
        """`values` with the defaults of the parameters it lacks; ValueError for an unknown one."""
        known = {p.name: p.default for p in self.parameters}
        for name in values:
            if name not in known:
                raise ValueError(f"effect {self.name} has no parameter '{name}', only {', '.join(known)}")
        return {**known, **values}

    def alter_drive(self, drive, values):
        """The drive as the vehicle makes it: for effects that turn the body on the same track."""
        return drive

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        """What the sensors measure, before their own errors: specific force and angular rate."""
        return specific_force, angular_rate

    def fix_times(self, time, values):
        """The times that fixes stamped `time`, (m,) s, describe."""
        return time

    def distort_fixes(self, drive, time, position, values, rng):
        """What the receiver measures before its white noise: `position`, (m, 3) m in `n`, described at `time`."""
        return position

    def temperature(self, drive, values, rng):
        """The sensor's temperature at `drive.time`, (n,) degrees Celsius, or None where it plays no part."""
        return None
