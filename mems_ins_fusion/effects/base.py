"""Base class of the effects. An effect is a property of real vehicles or sensors that the filter's model may lack."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mems_ins_fusion.errors import InputError


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    unit: SI, '-' for a ratio. prior_scale: a common size of the parameter, in this unit. default: its value in a
    simulation that gives only other parameters of the effect. variance: whether the parameter is a standard deviation,
    so that the innovations depend on its square. step: change of the parameter within which the innovations are about
    linear in it; 0: a tenth of prior_scale. adds_to: parameter of the YAML to which the estimate is added to correct
    the effect, with the index if that parameter is a list. sigma_in: parameter of the YAML that holds the standard
    deviation of that one, in the same unit; of a list it is the largest.
    """

    name: str
    unit: str
    prior_scale: float
    default: float = 0.0
    variance: bool = False
    step: float = 0.0
    adds_to: tuple[str] | tuple[str, int] | None = None
    sigma_in: str = ''


@dataclass(frozen=True)
class Sighting:
    """An effect that was found directly in the samples of a recording.

    parameters: parameters of the effect, name -> (value, sigma). text: the numbers and what they mean, without a full
    stop. helps: parameters of the YAML to change so that the filter tolerates the effect.
    """

    parameters: dict[str, tuple[float, float]]
    text: str
    helps: dict


class Effect:
    """One effect. Each module of this package contains one and overrides only the methods it needs.

    Most effects are fitted: a diagnosis estimates the parameters in `traced`. Some are found directly in the recording
    (`seen`); these have no traced parameters.

    The first methods are for simulations. `drive` is a `simulation.drive.Drive`, `values` the effect's parameters by
    name, `rng` a random number generator for this effect alone, started anew for each method. Specific forces and
    angular rates are (n, 3) in body axes `b`, in m/s^2 and rad/s, means over the interval before `drive.time`; times
    are s after the start of the drive.
    """

    name: str = ''
    parameters: tuple[EffectParameter, ...] = ()
    #: parameters in the YAML that belong to the effect alone: `parameters.Parameter`s
    settings: tuple = ()
    #: for the report: what the effect does to the innovations, and which other effects look the same
    signature: str = ''
    #: for the people who build vehicles: what is wrong (if empty, the name is used),
    in_words: str = ''
    #: what to check on the vehicle,
    to_check: str = ''
    #: and which other effects a single drive may not distinguish from it
    looks_the_same: str = ''
    #: the size of a parameter in words, with {} for the number: for a positive value, and for a negative one
    sizes: Mapping[str, tuple[str, str]] = {}
    #: the largest plausible size of each parameter, in its unit, and what the cause of a larger one is
    largest: Mapping[str, float] = {}
    larger_is: str = ''
    #: the smallest size of each parameter that shows this effect, and what the cause of a smaller one is
    smallest: Mapping[str, float] = {}
    smaller_is: str = ''
    #: sets of values of parameters that a diagnosis does not estimate but tries; the best set is kept
    tried: tuple[dict, ...] = ({},)
    #: names of tried parameters that are estimated as well once the effect is in the model
    refined: tuple[str, ...] = ()
    #: whether it only says how fixes scatter: it weighs them, and corrects nothing
    only_scatter: bool = False

    @property
    def traced(self) -> tuple[EffectParameter, ...]:
        """The parameters that a diagnosis estimates; those of the simulation unless the effect says otherwise."""
        return self.parameters

    def as_traced(self, values: dict) -> dict:
        """The parameters that are estimated, as they are for an effect simulated with `values` (complete)."""
        return values

    @property
    def principal(self) -> str:
        """Name of the parameter to which a single value for the effect belongs."""
        return self.parameters[0].name

    def complete(self, values: dict) -> dict:
        """`values` with the defaults of missing parameters. Raises InputError for an unknown parameter."""
        known = {p.name: p.default for p in self.parameters}
        for name in values:
            if name not in known:
                raise InputError(f"effect {self.name} has no parameter '{name}', only {', '.join(known)}")
        return {**known, **values}

    def alter_drive(self, drive, values):
        """The drive with the effect: for effects that rotate the body along the same track."""
        return drive

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        """Specific force and angular rate with the effect, before the errors of the sensors are added."""
        return specific_force, angular_rate

    def fix_times(self, time, values):
        """The times, (m,) s, that fixes stamped `time`, (m,) s, describe."""
        return time

    def measured_times(self, name, time, values):
        """The times, (m,) s, that measurements of the input `name` (not the fixes), stamped `time`, (m,) s, describe.
        """
        return time

    def measured_lag(self, name, values):
        """Time constant, s, of a low pass on the measurements of the input `name`."""
        return 0.0

    def dynamic_pressure(self, name, values):
        """Share of the dynamic pressure that the input `name` measures in addition."""
        return 0.0

    def turned(self, name, values):
        """Angle, rad, by which the axes of the odometry `name` are turned to the left."""
        return 0.0

    def distort_fixes(self, drive, time, position, values, rng):
        """Positions with the effect, before white noise is added. position: (m, 3) m in `n`. time: (m,) s."""
        return position

    def distort_samples(self, imu, values, rng):
        """The samples (`samples.ImuSamples`) as the driver delivers them: for effects of stamps and messages."""
        return imu

    def distort_speeds(self, speed, values):
        """Speeds with the effect, before the errors of the sensor are added. speed: (m,) m/s."""
        return speed

    def temperature(self, drive, values, rng):
        """The sensor's temperature at `drive.time`, (n,) degrees Celsius; None if the effect does not depend on it."""
        return None

    # From here on the methods are for diagnosis and correction. `values` are all parameters (`parameters.table.check`),
    # `theta` those of the effect.

    def adjusted(self, values: dict, theta: dict) -> dict:
        """The parameters with the correction of the effect by `theta`, as in `corrected.yaml`. By default each of
        `traced` is added to the parameter in its `adds_to`."""
        for parameter in self.traced:
            if parameter.adds_to is not None:
                values = with_added(values, *parameter.adds_to, change=theta[parameter.name])
        return values

    def replaces_model(self, theta: dict) -> bool:
        """Whether the effect with `theta` is corrected by another mechanization, not by a parameter."""
        return False

    def applied(self, values: dict, recording, theta: dict, attitude=None):
        """Parameters and recording for a filter that corrects the effect with `theta`: for the diagnosis.

        attitude: function of the recording that returns roll and pitch of the body, rad, at each IMU sample, 0 where
        they are unknown; for effects that need it.
        """
        return self.adjusted(values, theta), recording

    def leaves(self, values: Mapping) -> str:
        """What of the same cause its correction leaves, as the filter has no model of that. values: parameters."""
        return ''

    def hidden(self, values: dict, recording) -> str:
        """Why this recording, filtered with these parameters, contains no information on the effect; empty if it does.
        """
        return '' if self.traced else 'it is looked for in the data themselves, not in the innovations'

    def held(self, values: dict) -> dict:
        """The parameters `values`, changed such that the filter uses the value of the effect in them instead of
        estimating it. Otherwise two filters with different values would both converge to the same estimate."""
        return values

    def lasting(self, values: dict) -> float:
        """Correlation time, s, of the errors of the fixes, for a filter with `values` that contain the effect. Fixes
        that come sooner after the last one used have the same error, so they do not show where the vehicle is."""
        return 0.0

    def seen(self, values: dict, recording) -> Sighting | None:
        """The effect as found directly in the recording; None where it is not found, or is fitted."""
        return None

    def conditioning(self, values: dict):
        """A (6, 6) matrix that corrects (f, w) in body axes for the effect; None where it is zero in `values`."""
        return None

    def corrector(self, values: dict, rotation):
        """Function that corrects samples for the effect as they arrive; None where the effect is zero in `values`.

        rotation: (3, 3) from sensor to body axes. The function is called as corrector(stamp (n,) int64 ns, f (n, 3),
        w (n, 3), celsius (n,), NaN where unknown) with one or many samples in sensor axes and returns f and w. One call
        with many samples must give the same bits as many calls with one; it keeps what it needs of earlier samples.
        """
        return None


def with_added(values: dict, name: str, index: int | None = None, *, change: float) -> dict:
    """`values` with `change` added to one parameter, or to element `index` of one that has a value for each axis."""
    value = values[name]
    if index is None:
        return {**values, name: value + change}
    value = list(value) * 3 if len(value) == 1 else list(value)
    value[index] += change
    return {**values, name: value}
