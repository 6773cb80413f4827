"""What an effect is: something that real vehicles and sensors do and that the filter's model may lack."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mems_ins_fusion.errors import InputError


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    unit: SI, '-' for a ratio. prior_scale: a size that would surprise nobody in the field, in that unit.
    default: its value in a simulation that names only other parameters of the effect. variance: a standard deviation,
    which shows in the innovations by its square. step: over which the innovations change about linearly, a tenth of
    prior_scale where it is 0. adds_to: the parameter of the YAML that it is added to in order to take the effect out,
    and the element of a list.
    """

    name: str
    unit: str
    prior_scale: float
    default: float = 0.0
    variance: bool = False
    step: float = 0.0
    adds_to: tuple[str] | tuple[str, int] | None = None


@dataclass(frozen=True)
class Sighting:
    """What a direct look at a recording shows.

    parameters: those of the effect, name -> (value, sigma). text: the numbers and what they mean, without a full stop.
    helps: settings with which the filter bears it, parameters of the YAML that differ from those it has.
    """

    parameters: dict[str, tuple[float, float]]
    text: str
    helps: dict


class Effect:
    """One effect; each module of this package holds one and changes only the hooks it needs.

    Most effects are fitted: a diagnosis estimates what is `traced`. Some are seen, by a direct look at the recording
    (`seen`); of these nothing is traced.

    The simulated half follows. `drive` is a `simulation.drive.Drive`, `values` the effect's parameters by name, `rng`
    random numbers of the effect's own, started anew for each hook. Specific forces and angular rates are (n, 3) in body
    axes `b`, in m/s^2 and rad/s, means over the interval before `drive.time`; times are s after the start of the drive.
    """

    name: str = ''
    parameters: tuple[EffectParameter, ...] = ()
    #: what of it stands in the YAML beyond the filter's own parameters: `parameters.Parameter`s
    settings: tuple = ()
    #: for a reader of the report: what the residual shows, and what else shows the same
    signature: str = ''
    #: for the people who build vehicles: what is wrong, what to check on the vehicle, and what a single drive may not
    #: tell from it; without words it goes by its name
    in_words: str = ''
    to_check: str = ''
    looks_the_same: str = ''
    #: the size of a parameter in words, {} for the number: where it is above zero, and where below
    sizes: Mapping[str, tuple[str, str]] = {}
    #: the largest size of each parameter that somebody has built, in its unit, and what a larger one stands for
    largest: Mapping[str, float] = {}
    larger_is: str = ''
    #: the smallest size that is what it says, and what a smaller one is
    smallest: Mapping[str, float] = {}
    smaller_is: str = ''
    #: sets of parameters that a diagnosis does not estimate but tries at these values; the best set is kept
    tried: tuple[dict, ...] = ({},)
    #: names of tried parameters that are estimated, too, once the effect is in the model
    refined: tuple[str, ...] = ()

    @property
    def traced(self) -> tuple[EffectParameter, ...]:
        """The parameters that a diagnosis estimates; those of the simulation unless the effect says otherwise."""
        return self.parameters

    def as_traced(self, values: dict) -> dict:
        """What the effect, simulated with `values` (complete), comes to in the parameters that are estimated."""
        return values

    @property
    def principal(self) -> str:
        """The parameter that is meant where a user gives one value for the effect."""
        return self.parameters[0].name

    def complete(self, values: dict) -> dict:
        """`values` with the defaults of the parameters it lacks; InputError for an unknown one."""
        known = {p.name: p.default for p in self.parameters}
        for name in values:
            if name not in known:
                raise InputError(f"effect {self.name} has no parameter '{name}', only {', '.join(known)}")
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

    def measured_times(self, name, time, values):
        """The times that measurements of the input `name` besides the fixes, stamped `time`, (m,) s, describe."""
        return time

    def measured_lag(self, name, values):
        """Time constant, s, of a low pass that measurements of the input `name` come through."""
        return 0.0

    def distort_fixes(self, drive, time, position, values, rng):
        """What the receiver measures before its white noise: `position`, (m, 3) m in `n`, described at `time`."""
        return position

    def distort_samples(self, imu, values, rng):
        """The samples (`samples.ImuSamples`) as the driver delivers them: for effects of stamps and messages."""
        return imu

    def distort_speeds(self, speed, values):
        """What the wheels measure before their own errors: `speed`, (m,) m/s."""
        return speed

    def temperature(self, drive, values, rng):
        """The sensor's temperature at `drive.time`, (n,) degrees Celsius, or None where it plays no part."""
        return None

    # The correcting half. `values` are the parameters of `parameters.table.check` from here on, `theta` those of the
    # effect.

    def adjusted(self, values: dict, theta: dict) -> dict:
        """The parameters with the effect's changed by `theta`: what `corrected.yaml` will hold. By default each of
        `traced` is added to the parameter that it names."""
        for parameter in self.traced:
            if parameter.adds_to is not None:
                values = added(values, *parameter.adds_to, change=theta[parameter.name])
        return values

    def replaces_model(self, theta: dict) -> bool:
        """Whether `theta` is taken out by another mechanization, not by a parameter."""
        return False

    def applied(self, values: dict, recording, theta: dict, attitude=None):
        """Parameters and recording as a filter would have to see them if `theta` were true: for the diagnosis.

        attitude: called with the recording, it gives roll and pitch of the body, rad, at each IMU sample, 0 where not
        known; for effects that need it.
        """
        return self.adjusted(values, theta), recording

    def hidden(self, values: dict, recording) -> str:
        """Why this recording, filtered with these parameters, can say nothing about the effect; empty if it can."""
        return '' if self.traced else 'it is looked for in the data themselves, not in the innovations'

    def held(self, values: dict) -> dict:
        """The parameters `values` for a filter that takes the effect as they say it is, where it would estimate it
        itself: two filters that do go on as if both had been given the same value."""
        return values

    def lasting(self, values: dict) -> float:
        """s, for which fixes hold the same error as `values`, with the effect in them, say. Fixes that come sooner
        after the last one used tell how well that error was followed, and not where the vehicle is."""
        return 0.0

    def seen(self, values: dict, recording) -> Sighting | None:
        """What a direct look at the recording shows of the effect; None where nothing, or where it is fitted."""
        return None

    def conditioning(self, values: dict):
        """A (6, 6) matrix that takes the effect out of body-axis (f, w), or None where `values` have none of it."""
        return None

    def corrector(self, values: dict, rotation):
        """What takes the effect out of samples as they arrive, or None where `values` have none of it.

        rotation: (3, 3) from sensor to body axes. Called as corrector(stamp (n,) int64 ns, f (n, 3), w (n, 3), celsius
        (n,), NaN where unknown) with samples in sensor axes, one or many, which must give the same bits; returns f and
        w. It remembers what it needs of earlier samples.
        """
        return None


def added(values: dict, name: str, index: int | None = None, *, change: float) -> dict:
    """`values` with `change` added to one parameter, or to element `index` of one that has a value for each axis."""
    value = values[name]
    if index is None:
        return {**values, name: value + change}
    value = list(value) * 3 if len(value) == 1 else list(value)
    value[index] += change
    return {**values, name: value}
