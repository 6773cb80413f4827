"""The list of all measurements; other parts of the package look them up here."""
from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from mems_ins_fusion.compiled import njit

from ...parameters.parameter import Parameter, ParameterError
from ..memory import Event, Kind
from . import position, wheel_vibration
from .base import FIRST_NAMED, Measurement
from .heading import Heading
from .inertial import Inertial
from .magnetometer import Magnetometer
from .pose import Pose
from .position import Fix
from .pressure import Pressure
from .speed import Speed
from .twist import Twist
from .velocity import Velocity

#: all but the fixes, in the order in which their parameters are documented
AIDING: tuple[Measurement, ...] = (Speed(), Velocity(), Twist(), Magnetometer(), Heading(), Pressure())
#: all, by number
MEASUREMENTS: dict[int, Measurement] = {measurement.kind: measurement for measurement in (Fix(), *AIDING)}
#: parameters of measurements made from the IMU samples themselves, without messages of their own
FROM_IMU: tuple[Parameter, ...] = (wheel_vibration.PARAMETER,)
assert len(MEASUREMENTS) == 1 + len(AIDING), 'two measurements with one number'
#: what a named input can measure, by `NAME.type`
TYPES = {measurement.name: measurement for measurement in (*MEASUREMENTS.values(), Pose())}
INERTIAL = Inertial()  # a named input can also be a further IMU
#: both: all that `NAME.type` can be
_NAMED = {**TYPES, INERTIAL.name: INERTIAL}
INPUTS = Parameter('inputs', [], 'text', 'Names of further inputs, any number, each with NAME.type '
                   f'({", ".join(sorted(_NAMED))}), NAME.topic, NAME.time_offset, NAME.sigma and others of its type, '
                   'NAME.lever_arm where it is measured. The parameters without a NAME describe one more input of each '
                   'type.')
_NAME = re.compile(r'[a-z][a-z0-9_]*')  # the name of an input


def by_kind(observing: tuple[tuple[int, Callable], ...]) -> Callable:
    """Compiled `observe` for the events of several kinds.

    observing: kind of event and `observe` of each; the last one observes all kinds that are not named before it.
    Compiled code cannot look a function up, so this is a chain of functions of two branches. The compiler inlines them.
    """
    (kind, observe_kind), *others = observing
    if not others:
        return observe_kind
    observe_other = by_kind(tuple(others))

    @njit(_nrt=False)
    def observe_one(mem, r, at, h, n, c, sample):
        if mem[at + Event.KIND] == kind:
            return observe_kind(mem, r, at, h, n, c, sample)
        return observe_other(mem, r, at, h, n, c, sample)

    return observe_one


#: compiled `observe` for the events of all inputs but the main receiver's fixes
observe = by_kind((*((one.kind, one.observe) for one in AIDING), (Kind.PLACE, position.observe_place)))


def named_parameters(values: Mapping, taken: Mapping) -> dict[str, Parameter]:
    """Parameters of the named inputs in the unchecked `values`; taken: all other parameters.

    Raises ParameterError where the definition of an input is wrong.
    """
    found: dict[str, Parameter] = {}
    names = INPUTS.check(values.get('inputs', []))
    for name in names:
        if not _NAME.fullmatch(name) or names.count(name) > 1:
            raise ParameterError(f"parameter 'inputs' must have different names of small letters, digits and _, got "
                                 f"'{name}'")
        if name in ('temperature', *_NAMED) or any(one.startswith(f'{name}.') for one in taken):
            raise ParameterError(f"parameter 'inputs': '{name}' is the prefix of other parameters, choose another name")
        for needed in ('type', 'topic'):
            if not values.get(f'{name}.{needed}'):
                raise ParameterError(f"parameter '{name}.{needed}' is missing: 'inputs' has '{name}'")
        if values[f'{name}.type'] not in _NAMED:
            raise ParameterError(f"parameter '{name}.type' must be one of {', '.join(sorted(_NAMED))}; got "
                                 f"'{values[f'{name}.type']}'")
        found |= {p.name: p for p in _NAMED[values[f'{name}.type']].named(name, 0).named_parameters()}
    return found


def aiding(values: Mapping) -> tuple[Measurement, ...]:
    """All inputs but the main receiver's fixes: those of AIDING, and the named ones of the checked `values`."""
    names = [name for name in values.get('inputs', ()) if values[f'{name}.type'] in TYPES]
    return (*AIDING, *(TYPES[values[f'{name}.type']].named(name, number, values.get(f'{name}.lever_arm', (0.0,) * 3))
                       for number, name in enumerate(names, start=FIRST_NAMED)))


def imus(values: Mapping) -> tuple[Inertial, ...]:
    """The further IMUs of the checked `values`, in the order of preference."""
    found = []
    for name in values.get('inputs', ()):
        if values[f'{name}.type'] == INERTIAL.name:
            found.append(INERTIAL.named(name, 0, values[f'{name}.lever_arm']))
            found[-1].mounting_rpy = tuple(values[f'{name}.mounting_rpy'])
    return tuple(found)


def further_inputs(values: Mapping) -> tuple[Measurement, ...]:
    """All inputs but the first IMU and the main receiver's fixes."""
    return (*aiding(values), *imus(values))


def inputs(values: Mapping) -> dict[int, Measurement]:
    """All inputs but IMUs, the fixes too, by number."""
    return {measurement.number: measurement for measurement in (MEASUREMENTS[Kind.POSITION], *aiding(values))}
